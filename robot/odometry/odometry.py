"""Turns the firmware's readings into bus messages: time, frame names, restarts."""

from msgspec import Struct
from msgspec.structs import replace

from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose
from trigpoint.robot.line.protocol import Reading


class Stamped(Struct, frozen=True):
    """A published pose. `stamp_ns`: Unix time; `firmware_ns`: the firmware's clock then."""

    stamp_ns: int
    firmware_ns: int
    odom_from_base: Pose


class OdometryStream:
    """The robot's odometry frame on the bus, which never jumps.

    A restarted firmware counts from zero again, in an odometry frame of its own. The frame on the
    bus continues: the first pose after the restart is put where the last one before it was. How the
    robot moved in between is unknown here; see decisions/0301-restarted-firmware.md.
    """

    def __init__(self, robot: str) -> None:
        self._frame, self._child = f"{robot}/odom", f"{robot}/base"
        self._odom_from_counted = Pose.identity()
        self._is_restarted = False
        self._last: Stamped | None = None

    @property
    def last(self) -> Stamped | None:
        """The pose published last."""
        return self._last

    @property
    def odom_from_counted(self) -> Pose:
        """Pose of the robot's own odometry frame in the one on the bus."""
        return self._odom_from_counted

    def restart(self) -> None:
        """The firmware restarted: its new count continues from the robot's last pose."""
        self._is_restarted = self._last is not None

    def shift(self, by_ns: int) -> None:
        """Continue with stamps of a clock that is this much ahead of the previous one."""
        if self._last is not None:
            self._last = replace(self._last, stamp_ns=self._last.stamp_ns + by_ns)

    def add(self, reading: Reading, stamp_ns: int) -> Odometry | None:
        """The message for a reading; None if it is not later than the last one."""
        if self._last is not None and stamp_ns <= self._last.stamp_ns:
            return None
        if self._is_restarted and self._last is not None:
            self._odom_from_counted = self._last.odom_from_base @ reading.pose.inverse()
            self._is_restarted = False
        pose = self._odom_from_counted @ reading.pose
        self._last = Stamped(stamp_ns, reading.firmware_ns, pose)
        return Odometry(
            stamp_ns, self._frame, self._child, pose, reading.linear.copy(), reading.angular.copy()
        )
