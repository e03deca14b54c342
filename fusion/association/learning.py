"""Learns the noise of a session from its observations: of each camera's corners and each robot."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation

from .events import Events
from .linear import Linear
from .local import LocalProblem
from .memory import Memory
from .mode import Mode
from .modes import ModeFinder
from .noise import PESSIMISTIC, STATED, Noise, on_a_floor, with_noise
from .variances import corner_scale, learn
from .visits import Visit, telling, telling_of_lenses, visits_of

_MOST_SCATTERS = 40


class SessionNoise(Struct, frozen=True):
    """A hypothesis of the noise of each robot, and the score of its prior."""

    by_robot: dict[str, Noise]
    score: float = 0.0


def learnt_noise(
    data: DataSet, observations: list[Observation], events: Events, memory: Memory
) -> tuple[dict[str, float], list[SessionNoise]]:
    """Return, by camera, the factor on its corners' stated sigma, and the hypotheses of the robots'
    noise, the least first.

    Where the session determines a robot's noise, it is that one, with an alternative if events may
    have been taken for noise (`learn`); else the stated one or the pessimistic one. The latter has
    the prior `Events.noise_score` only if corners scatter as stated; if they scatter more, a third
    hypothesis has only odometry noisier, by the same factor.
    """
    wide = with_noise(data, dict.fromkeys(data.site.robots, PESSIMISTIC))
    known_lens = {n for n, c in data.site.cameras.items() if not c.estimates_intrinsics}
    scatters = _scatters(data, observations, events, known_lens, memory)
    scales, _ = _corner_scales(observations, scatters)
    seen = [memory.scattering(o, scales[o.camera]) for o in observations]
    finder = ModeFinder(wide, seen, events, memory)
    visits = visits_of(data, observations)
    found = [finder.modes_of(visit) for visit in telling(visits)]
    for visit in telling_of_lenses(visits, data.site.cameras.keys() - known_lens):
        memory.learn_lens(finder.modes_of(visit))
    scatters |= _scatters(data, observations, events, set(memory.lenses), memory)
    scales, common = _corner_scales(observations, scatters)
    seen = [memory.scattering(o, scales[o.camera]) for o in observations]
    by_robot: dict[str, dict[tuple[object, ...], Linear]] = {}
    for modes in found:
        if not modes.modes:
            continue
        visit = _with_neighbours(modes.visit)
        pictures = {index: seen[index] for index in visit.chosen}
        key = *finder.key(modes.visit), *(each.views for each in pictures.values())
        shown = memory.shown.get(key) or _shown(data, visit, pictures, modes.modes[0], finder)
        if shown is not None:
            by_robot.setdefault(visit.robot, {})[key] = memory.shown.put(key, shown)
    learnt = {robot: _learnt(data, robot, mine, finder) for robot, mine in by_robot.items()}
    unknown = {
        robot: _unknown(common, events, planar=data.tracks[robot].planar)
        for robot in data.site.robots
    }
    return scales, _worlds({robot: learnt.get(robot, (None,)) for robot in unknown}, unknown)


def _corner_scales(
    observations: list[Observation], scatters: dict[str, list[float]]
) -> tuple[dict[str, float], float]:
    """Return, by camera, the factor on its corners' stated sigma, and that of all cameras together,
    which a camera has whose own boards show none."""
    common = corner_scale([each for mine in scatters.values() for each in mine])
    own = {name: corner_scale(mine) for name, mine in scatters.items()}
    return {o.camera: own.get(o.camera, common) for o in observations}, common


def _unknown(common: float, events: Events, *, planar: bool) -> list[tuple[Noise, float]]:
    """Return what the noise of a robot may be where nothing determines it, the least first, each
    with the score of its prior; `common`: the factor on the corners' stated sigma."""
    priors = events.priors
    swaying = replace(STATED, sway=priors.target_sway)
    least = on_a_floor(swaying, priors.floor_tilt) if planar else STATED
    if common == 1.0:
        return [(least, 0.0), (PESSIMISTIC, events.noise_score)]
    pessimistic = replace(PESSIMISTIC, odometry=max(PESSIMISTIC.odometry, common))
    noisier = [replace(least, odometry=common)] if common > 1.0 else []
    return [(noise, 0.0) for noise in (least, *noisier, pessimistic)]


def _worlds(
    told: dict[str, tuple[Noise | None, ...]], unknown: dict[str, list[tuple[Noise, float]]]
) -> list[SessionNoise]:
    """Return the hypotheses of the noise of all robots, the least first. `told`: by robot, the
    noise learnt and its alternatives, in which None stands for all of its `unknown` ones; these
    have the scores of their priors."""
    may_be = {
        robot: [one for noise in noises for one in ([(noise, 0.0)] if noise else unknown[robot])]
        for robot, noises in told.items()
    }
    found = []
    for number in range(max(map(len, may_be.values()))):
        each = {robot: ones[min(number, len(ones) - 1)] for robot, ones in may_be.items()}
        by_robot = {robot: noise for robot, (noise, _) in each.items()}
        found.append(SessionNoise(by_robot, max(score for _, score in each.values())))
    return found


def _shown(
    data: DataSet,
    visit: Visit,
    pictures: dict[int, Observation],
    mode: Mode,
    finder: ModeFinder,
) -> Linear | None:
    """Return what these pictures of a visit show of the noise about one of its modes; None where
    nothing. `finder`: with pessimistic noise, under which modes are solved."""
    events, odometry = finder.events, finder.odometry(visit)
    unscored = {index: (0.0,) * len(picture.views) for index, picture in pictures.items()}
    budget = finder.memory.budget
    problem = LocalProblem(finder.data, pictures, odometry, unscored, events, budget)
    more = problem.mode_near(mode.camera, problem.wrong_by(mode))
    if more is None:
        return None
    return LocalProblem(data, pictures, odometry, {}, events).residuals(more)


def _learnt(
    data: DataSet, robot: str, shown: dict[tuple[object, ...], Linear], finder: ModeFinder
) -> tuple[Noise | None, ...]:
    """Return a robot's noise and its alternatives by what its visits show."""
    memory, key = finder.memory, (robot, *shown)
    found = memory.noise.get(key)
    if found is None:
        planar = data.tracks[robot].planar
        found = learn(list(shown.values()), finder.events, memory.budget, planar=planar)
        if not memory.budget.is_spent:
            memory.noise.put(key, found)
    return found


def _with_neighbours(visit: Visit) -> Visit:
    """Return a visit in which the picture after each chosen one is chosen too: pictures both near
    each other and far apart show the correlation length of a floor's slope."""
    rows = {visit.indices.index(index) for index in visit.chosen}
    near = rows | {row + 1 for row in rows if row + 1 < len(visit.indices)}
    return replace(visit, chosen=tuple(visit.indices[row] for row in sorted(near)))


def _scatters(
    data: DataSet,
    observations: list[Observation],
    events: Events,
    cameras: set[str],
    memory: Memory,
) -> dict[str, list[float]]:
    """Return, by camera, for each of these `cameras` that has any, the variances of the corners of
    single boards relative to the stated ones (`Alone.scatter`)."""
    finder = ModeFinder(data, observations, events, memory)
    scatters: dict[str, list[float]] = {}
    for index, observation in enumerate(observations):
        mine = scatters.setdefault(observation.camera, [])
        if memory.budget.is_spent:
            break
        if observation.camera in cameras and len(mine) < _MOST_SCATTERS:
            mine += [a.scatter for a in finder.alone(index) if np.isfinite(a.scatter)]
    return {name: mine for name, mine in scatters.items() if mine}
