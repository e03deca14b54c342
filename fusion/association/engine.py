"""The engine: observations and odometry in, the explanation of the session out.

It learns the session's noise, finds every mode of every visit, searches the joint explanations and
verifies the best one (`world`), and derives from all of them what is known of each camera
(`outcome`).
"""

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation

from .budget import ALIKE_SHARE, Budget
from .events import Events, window
from .explanation import Explanation
from .learning import learnt_noise
from .memory import Memory
from .outcome import Outcome
from .scales import with_learnt_scales
from .world import World

# A world's score may still fall while it is verified, but hardly by as much as this.
_FAR = 2 * window()


def explain(
    data: DataSet,
    observations: list[Observation],
    memory: Memory | None = None,
    budget: Budget | None = None,
    *,
    undecided: frozenset[str] = frozenset(),
    is_draft: bool = False,
) -> Explanation:
    """Find what explains all observations of the site's cameras, given in order of their stamps.

    `data`: site, targets, lenses, odometry and what is known beforehand; nothing in it is changed.
    `memory`: of the last search, over fewer observations of the same session; `budget`: of work,
    from the session's length if not given; `undecided`: cameras that are not to be located, since
    it is not known what other pictures of theirs show; `is_draft`: report each camera at its
    likeliest place alone, whatever the alternatives.
    """
    events, memory = Events(data.site.fusion.priors), memory or Memory()
    memory.budget = budget or Budget.of(data.tracks.values(), share=_share(data))
    memory.budget.spend_reading(views=sum(len(each.views) for each in observations))
    data = replace(data, tracks={n: track.mended() for n, track in data.tracks.items()})
    data = with_learnt_scales(data, observations, events, memory)
    corner_scale, noises = learnt_noise(data, observations, events, memory)
    seen = [memory.scattering(o, corner_scale[o.camera]) for o in observations]
    worlds: list[World] = []
    for noise in noises:
        # Scores are comparable only over the same pictures: all worlds have the first one's visits.
        parts = [each.visit for each in worlds[0].visits] if worlds else None
        worlds.append(World(data, seen, events, noise, memory, parts, is_draft=is_draft))
        if worlds[-1].undecided:
            break  # what the others find decides nothing
    else:
        _verify(worlds)
    memory.trails = [world.trail for world in worlds]
    memory.forget_unused()
    return Outcome(worlds, seen, corner_scale, undecided, is_draft=is_draft).explanation()


def _verify(worlds: list[World]) -> None:
    """Verify the worlds, the likeliest first; one that is far behind has no share in any decision,
    and is left as it was found."""
    least = np.inf
    for world in sorted(worlds, key=lambda world: world.score):
        if world.score < least + _FAR:
            world.verify()
            least = min(least, world.score)


def _share(data: DataSet) -> float:
    """Return the share of the budget for this search: less than all of it where robots look alike,
    since telling them apart may take as much work as all else."""
    return ALIKE_SHARE if data.has_alike_robots else 1.0
