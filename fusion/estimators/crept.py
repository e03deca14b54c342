"""How far cameras may have crept within a session, which is solved as though they hung still.

In hours that is next to nothing; a session that goes on for weeks is a mean over them. With the
weights w of a camera's sightings and their ages a, the mean of its random walk is off by creep² ·
Σᵢⱼ wᵢ wⱼ min(aᵢ, aⱼ) from where it hangs at the end, which is at most creep² times the mean age.
"""

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.known_cameras import Creep
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.solver.filter import Filter
from trigpoint.geometry.rotation import Array


def newest_ns(data: DataSet) -> int | None:
    """The stamp of the newest sighting; without one, the time of what is known beforehand."""
    stamps = (entry.observation.stamp_ns for entry in data.entries)
    return max(stamps, default=data.known_at_start.until_ns)


def crept(data: DataSet, after: Filter) -> dict[str, Array]:
    """By camera that creeps, the covariance (6, 6) to add to what was solved as though nothing did.

    However little: a past is summarised many times, and what is between two cameras is known far
    better than where each of them is."""
    end_ns, found = newest_ns(data), {}
    for name, camera in data.site.cameras.items():
        places = [place for place in data.places_of(name) if after.has_camera(place)]
        if end_ns is None or not places:
            continue
        spread = Creep.of(camera).covariance(_age_ns(data, places[-1], end_ns))
        if np.any(spread):
            found[places[-1]] = spread
    return found


def _age_ns(data: DataSet, camera: str, end_ns: int) -> float:
    """The mean age of what a camera's pose rests on. What was known of it beforehand is as old as
    the session, and may weigh as much as all sightings."""
    if camera in data.known.poses:
        return end_ns - max(data.begin_ns, data.known_at_start.until_ns or 0)
    used = [
        end_ns - entry.observation.stamp_ns
        for entry in data.of_camera(camera)
        if entry.observation.verdict is Verdict.ACCEPTED
    ]
    return float(np.mean(used)) if used else 0.0
