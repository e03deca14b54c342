"""Finds which of several robots with equal targets a camera saw, by how each of them drove."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Reading, View, observation_of
from trigpoint.geometry import Pose

from .events import Events
from .memory import Memory
from .mode import Mode, VisitModes
from .modes import ModeFinder, renumbered
from .noise import PESSIMISTIC, with_noise
from .variances import corner_scale
from .visits import visit_of, visits_of

# So many pictures of a visit tell which robot drove so; locating the camera takes more of them.
_MOST_VIEWS = 6


class Picture(Struct, frozen=True):
    """One picture. `faces`: for each that it shows, the view by every robot that may carry it."""

    stamp_ns: int
    faces: tuple[dict[str, View], ...]

    def of(self, robot: str) -> tuple[int, ...]:
        """The indices of the faces that may be a robot's."""
        return tuple(order for order, face in enumerate(self.faces) if robot in face)

    def showing(self, faces: Sequence[int]) -> "Picture":
        """The picture with only these of its faces."""
        return Picture(self.stamp_ns, tuple(self.faces[order] for order in faces))


class RobotFit(Struct, frozen=True):
    """How one robot's odometry explains a visit, wherever the camera may be.

    `gain`: by how much the score is better than with all sightings wrong; `pictures`: those that
    may show the robot, one for each row of `finder`; `found`: the visit's modes; `scatter`: of its
    corners, in the sigmas that they state.
    """

    gain: float
    pictures: tuple[int, ...]
    finder: ModeFinder
    found: VisitModes
    scatter: float

    @property
    def mode(self) -> Mode:
        """The best mode, over the visit's chosen rows."""
        return self.found.modes[0]

    def right(self, visit: Sequence[Picture]) -> dict[int, tuple[int, ...]]:
        """By picture, in order of time, which faces are the robot's by the best mode."""
        robot = self.found.visit.robot
        whole = self.finder.completed(self.found.visit, self.mode)
        return {
            self.pictures[row]: _shown(visit[self.pictures[row]].of(robot), readings)
            for row, readings in sorted(whole.readings.items())
        }

    def claims(self, pictures: Sequence[Picture]) -> dict[int, tuple[int, ...]]:
        """By picture, which faces of further pictures of the visit would be the robot's too."""
        finder, visit = self.finder, self.found.visit
        others = _observations(finder.data, visit.camera, visit.robot, pictures)
        known = len(visit.chosen)
        whole = [finder.observations[row] for row in visit.chosen]
        whole += [each.scattering(self.scatter) for each in others.values()]
        wider = replace(visit, indices=tuple(range(len(whole))), chosen=tuple(range(known)))
        mode = renumbered(self.found, wider).modes[0]
        read = ModeFinder(finder.data, whole, finder.events, finder.memory).completed(wider, mode)
        return {
            order: _shown(pictures[order].of(visit.robot), read.readings[known + row])
            for row, order in enumerate(others)
        }

    def chosen(self) -> dict[int, Observation]:
        """By picture, for the chosen ones that show the robot, its own sightings as they are
        read."""
        mode = self.mode
        return {
            self.pictures[row]: own
            for row, readings in mode.readings.items()
            if (own := _right(self.finder.observations[row], readings, mode.wild[row])) is not None
        }

    def poses(self) -> dict[int, Pose]:
        """By chosen picture, the robot's pose by the best mode, in its odometry's frame."""
        return {self.pictures[row]: pose for row, pose in self.mode.poses.items()}


def fits(
    data: DataSet,
    camera: str,
    pictures: Sequence[Picture],
    events: Events,
    memory: Memory | None = None,
) -> dict[str, RobotFit]:
    """By robot, how it explains the pictures of a visit, which are in order of time; only robots
    that may be in them and explain them at all, within the budget. A robot is not in a picture that
    its odometry does not cover. `memory`: holds the budget and what is known of single views.
    """
    known, robots = memory or Memory(), _robots(pictures)
    noisy = with_noise(data, dict.fromkeys(robots, PESSIMISTIC))
    # Modes name pictures by their indices, which here count these pictures alone: a cache apart.
    own = Memory(known.budget, known.alone)
    found = {robot: _fit(noisy, camera, robot, pictures, events, own) for robot in robots}
    return {robot: fit for robot, fit in found.items() if fit is not None}


def runs(data: DataSet, camera: str, pictures: Sequence[Picture]) -> list[list[Picture]]:
    """Cut pictures, in order of time, where odometry drifts too far for one visit of any robot."""
    starts = {0}
    for robot in _robots(pictures):
        seen = _observations(data, camera, robot, pictures)
        orders = list(seen)
        starts |= {orders[v.indices[0]] for v in visits_of(data, list(seen.values()))}
    ends = [*sorted(starts)[1:], len(pictures)]
    return [list(pictures[start:end]) for start, end in zip(sorted(starts), ends, strict=True)]


def _robots(pictures: Sequence[Picture]) -> list[str]:
    return list(dict.fromkeys(name for p in pictures for face in p.faces for name in face))


def _fit(
    data: DataSet,
    camera: str,
    robot: str,
    pictures: Sequence[Picture],
    events: Events,
    memory: Memory,
) -> RobotFit | None:
    seen = _observations(data, camera, robot, pictures)
    if not seen:
        return None
    observations = list(seen.values())
    visit = visit_of(observations, list(range(len(observations))), most=_MOST_VIEWS)
    finder = ModeFinder(data, observations, events, memory)
    scatters = [view.scatter for index in visit.chosen for view in finder.alone(index)]
    scale = corner_scale([scatter for scatter in scatters if np.isfinite(scatter)])
    if scale != 1.0:
        observations = [observation.scattering(scale) for observation in observations]
        finder = ModeFinder(data, observations, events, memory)
    found = finder.modes_of(visit)
    if not found.modes:
        return None
    gain = found.nothing - found.modes[0].evidence
    return RobotFit(gain, tuple(seen), finder, found, scale)


def _shown(faces: tuple[int, ...], readings: tuple[Reading | None, ...]) -> tuple[int, ...]:
    return tuple(face for face, r in zip(faces, readings, strict=True) if r is not None)


def _right(
    seen: Observation, readings: tuple[Reading | None, ...], wild: tuple[np.ndarray, ...]
) -> Observation | None:
    """The observation with only the views that are right; None where none is."""
    own = [each for each in zip(seen.views, readings, wild, strict=True) if each[1] is not None]
    if not own:
        return None
    views, chosen, outliers = zip(*own, strict=True)
    return replace(seen, views=views, chosen=chosen, outliers=outliers)


def _observations(
    data: DataSet, camera: str, robot: str, pictures: Sequence[Picture]
) -> dict[int, Observation]:
    """By picture, an observation of what may be this robot, where its odometry covers that."""
    found = {}
    for order, picture in enumerate(pictures):
        views = tuple(picture.faces[face][robot] for face in picture.of(robot))
        if views and data.tracks[robot].covers(picture.stamp_ns):
            observation = observation_of(camera, robot, picture.stamp_ns, views)
            found[order] = data.moving(observation, observation.stamp_ns)
    return found
