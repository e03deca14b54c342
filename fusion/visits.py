"""A robot's visits to cameras: its sightings by one of them, one after the other.

Between two visits a robot may have been lifted, or a camera moved, without a trace. Within a visit
it shows: from one picture to the next the robot is elsewhere than its odometry says.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.geometry import Pose

from .alignment import align
from .dataset import DataSet
from .judge import DECISIVE
from .observations import Observation
from .odometry_track import SPATIAL
from .starts import spread

# A visit also ends where nothing sees the robot for this long.
_LONGEST_PAUSE_NS = to_ns(2.0)
# By how much the way between two pictures must differ from odometry, far beyond what one picture
# of few corners leaves open.
_LEAST_SHIFT_M = 0.1
_LEAST_TURN_RAD = 0.1
_LEAST_SIGHTINGS = 3
# Between so many of a visit's sightings every jump shows that leaves so many on both sides of it.
_FEW_SIGHTINGS = 6


@dataclass(frozen=True, slots=True)
class Visit:
    """Sightings of one robot by one camera, in order of time."""

    camera: str
    robot: str
    observations: tuple[Observation, ...]

    @property
    def first_ns(self) -> int:
        return self.observations[0].stamp_ns

    @property
    def last_ns(self) -> int:
        return self.observations[-1].stamp_ns

    def thinned(self, most: int) -> tuple[Observation, ...]:
        """At most so many of its observations, spread evenly, with the first and the last."""
        count = len(self.observations)
        chosen = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
        return tuple(self.observations[index] for index in chosen)


def visits_of(data: DataSet, observations: list[Observation]) -> list[Visit]:
    """The visits of every robot, in order of their beginnings; they may overlap."""
    runs: dict[tuple[str, str], list[Observation]] = {}
    found: list[Visit] = []
    for observation in sorted(observations, key=lambda o: o.stamp_ns):
        run = runs.setdefault((observation.robot, observation.camera), [])
        if run and observation.stamp_ns - run[-1].stamp_ns > _LONGEST_PAUSE_NS:
            found += _split(data, run)
            run.clear()
        run.append(observation)
    for run in runs.values():
        found += _split(data, run)
    return sorted(found, key=lambda visit: (visit.first_ns, visit.camera))


def _split(data: DataSet, run: list[Observation]) -> list[Visit]:
    """Sightings without a pause as one visit, or as two where robot or camera jumped within it."""
    camera, robot = run[0].camera, run[0].robot
    at = _jump_within(data, run)
    parts = [run[:at], run[at:]] if at else [run]
    return [Visit(camera, robot, tuple(part)) for part in parts]


def _jump_within(data: DataSet, run: list[Observation]) -> int:
    """At which of its sightings the robot stands elsewhere before the camera than odometry
    leads; 0 where there is none, or only single ones that are wrong."""
    few = spread(list(range(len(run))), _FEW_SIGHTINGS)
    if not _jumps(data, run, _seen(data, run, few)):
        return 0
    places = _seen(data, run, list(range(len(run))))
    jumps = _jumps(data, run, places)
    # A single wrong sighting is a jump there and back.
    lasting = [n for n in jumps if {n - 1, n + 1}.isdisjoint(jumps)]
    inner = [n for n in lasting if _LEAST_SIGHTINGS <= n <= len(places) - _LEAST_SIGHTINGS]
    return places[inner[0]][0] if len(inner) == 1 else 0


def _seen(data: DataSet, run: list[Observation], numbers: list[int]) -> list[tuple[int, Pose]]:
    """Those of the sightings by these numbers that say alone where the robot was, and where."""
    return [(number, pose) for number in numbers if (pose := _seen_at(data, run[number]))]


def _jumps(data: DataSet, run: list[Observation], places: list[tuple[int, Pose]]) -> list[int]:
    """Which of these places are far from where odometry leads from the one before."""
    if len(places) < 2:
        return []
    stamps = np.array([run[number].stamp_ns for number, _ in places])
    steps = data.tracks[run[0].robot].motion(stamps, np.zeros(2)).earlier_from_later
    poses = [pose for _, pose in places]
    return [
        number + 1
        for number in range(len(places) - 1)
        if _is_far(poses[number].inverse() @ poses[number + 1], steps[number])
    ]


def _is_far(seen: Pose, driven: Pose) -> bool:
    apart = np.abs(driven.difference(seen))
    return bool(apart[:3].max() > _LEAST_SHIFT_M or apart[3:].max() > _LEAST_TURN_RAD)


def _seen_at(data: DataSet, observation: Observation) -> Pose | None:
    """camera_from_base by one observation alone; None where that can be read in two ways."""
    alignment = align(
        observation,
        data.targets[observation.robot],
        data.lenses[observation.camera],
        Pose.identity(),
        tangent=SPATIAL,
        prior=None,
        extra_sigma_px=0.0,
    )
    if alignment is None or alignment.margin < DECISIVE:
        return None
    return alignment.map_from_base
