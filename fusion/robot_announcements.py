"""Announcements of the robots: where they are, and the corrections that they are to take."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from uuid import UUID

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.correction import LEAST_SIGMA, CorrectionMark, encode_mark
from trigpoint.contract.messages import PoseArray, PoseEstimate, Transform, Transforms
from trigpoint.contract.topics import Topic
from trigpoint.geometry import Pose

from .model.observations import Observation
from .output import Output
from .solver.filter import RobotEstimate

_TF_PERIOD_NS = to_ns(0.1)
_PARTICLES_PERIOD_NS = to_ns(0.5)
_SEQUENCE_MARGIN = 1000


class RobotAnnouncements:
    """What was announced of each robot, and when it is due again. Not thread-safe.

    `correction_rate`: corrections of a robot a second, at most.
    """

    def __init__(self, correction_rate: float) -> None:
        self._correction_period_ns = to_ns(1 / correction_rate)
        self._correction_due_ns: dict[str, int] = {}
        self._sequence: Counter[str] = Counter()
        self._said_ns: dict[tuple[Topic, str], int] = {}

    def place(
        self,
        robot: str,
        estimate: RobotEstimate,
        odom_from_base: Pose,
        particles: Callable[[str], Pose | None],
    ) -> Iterator[Output]:
        """What to say of a robot at its last odometry message, which gave `odom_from_base`;
        `particles`: where it may be, by an estimator that has them."""
        stamp_ns, pose = estimate.stamp_ns, estimate.map_from_base
        yield Output(topics.ROBOT_POSE, robot, _message(estimate))
        if self._is_due(topics.PARTICLES, robot, stamp_ns):
            poses = particles(robot)
            if poses is not None:
                yield Output(topics.PARTICLES, robot, PoseArray(stamp_ns, "map", poses))
        if self._is_due(topics.TF, robot, stamp_ns):
            transforms = (
                Transform(stamp_ns, "map", f"{robot}/odom", pose @ odom_from_base.inverse()),
                Transform(stamp_ns, f"{robot}/odom", f"{robot}/base", odom_from_base),
            )
            yield Output(topics.TF, "", Transforms(transforms))

    def correction(
        self, map_id: UUID, observation: Observation, estimate: RobotEstimate
    ) -> Iterator[Output]:
        """A correction in a map by an observation of the robot, where the rate allows one now, and
        something was measured: a robot that stands where the map begins is there by definition.
        """
        robot = observation.robot
        plane = np.diagonal(estimate.covariance)[[0, 1, 5]]
        if plane.min() >= LEAST_SIGMA**2 and self._is_correction_due(robot, estimate.stamp_ns):
            self._sequence[robot] += 1
            mark = encode_mark(CorrectionMark(map_id, self._sequence[robot]))
            yield Output(topics.CORRECTION, robot, _message(estimate), mark, observation)

    def skip_corrections(self, robots: Iterable[str]) -> None:
        """Go on well beyond the corrections that an earlier process may have sent: a robot refuses
        a sequence number that it has seen."""
        for robot in robots:
            self._sequence[robot] += _SEQUENCE_MARGIN

    def _is_correction_due(self, robot: str, stamp_ns: int) -> bool:
        """Whether a correction is due. It may be half a period early without moving the schedule,
        so that jitter does not halve the corrections of pictures at just that rate."""
        period_ns = self._correction_period_ns
        due_ns = max(self._correction_due_ns.get(robot, stamp_ns), stamp_ns - period_ns // 2)
        if stamp_ns < due_ns - period_ns // 2:
            return False
        self._correction_due_ns[robot] = due_ns + period_ns
        return True

    def _is_due(self, topic: Topic, robot: str, stamp_ns: int) -> bool:
        period_ns = _TF_PERIOD_NS if topic is topics.TF else _PARTICLES_PERIOD_NS
        last_ns = self._said_ns.get((topic, robot))
        if last_ns is not None and 0 <= stamp_ns - last_ns < period_ns:
            return False
        self._said_ns[topic, robot] = stamp_ns
        return True


def _message(estimate: RobotEstimate) -> PoseEstimate:
    return PoseEstimate(estimate.stamp_ns, "map", estimate.map_from_base, estimate.covariance)
