"""The bridge without bus and port: events in, messages and corrections out, everything counted."""

from uuid import UUID

import numpy as np
import pytest

from trigpoint.clock import ManualClock, to_ns
from trigpoint.config import RobotConfig
from trigpoint.correction import CorrectionMark
from trigpoint.geometry import Pose
from trigpoint.health import Health
from trigpoint.messages import Odometry, PoseEstimate
from trigpoint.robot.bridge import Bridge, Offset
from trigpoint.robot.protocol import (
    Acknowledged,
    ClockExchange,
    Connected,
    Damaged,
    DamageKind,
    Mismatched,
    Missing,
    Reading,
    RobotCorrection,
    Silent,
    Unanswered,
    Vitals,
)

UNIX_NS = to_ns(1_700_000_000.0)
FIRMWARE_NS = to_ns(77.0)
MAP = UUID(int=1)


class Robot:
    """A bridge, and a robot that stands at x = 1 m; times in seconds of the machine's clock."""

    def __init__(self) -> None:
        self.health = Health(ManualClock())
        config = RobotConfig(port="x")
        self.bridge = Bridge("r1", config, self.health, Offset(UNIX_NS))

    def connect(self, boot: int = 1, at_s: float = 0.0) -> None:
        self.bridge.on_event(Connected("r1", "test", boot))
        for k in range(5):
            middle_ns = to_ns(at_s) + to_ns(0.02 * k)
            way_ns = to_ns(0.0001)
            self.bridge.on_event(
                ClockExchange(middle_ns - way_ns, middle_ns + FIRMWARE_NS, middle_ns + way_ns)
            )

    def read(self, at_s: float, x: float = 1.0) -> Odometry | None:
        return self.read_firmware(to_ns(at_s) + FIRMWARE_NS, at_s, x)

    def read_firmware(self, firmware_ns: int, at_s: float, x: float = 1.0) -> Odometry | None:
        pose = Pose.planar(x, 0, 0)
        reading = Reading(firmware_ns, to_ns(at_s), pose, np.zeros(3), np.zeros(3))
        return self.bridge.on_event(reading)

    def stand(self, begin_s: float, end_s: float) -> None:
        for at_s in np.arange(begin_s, end_s, 0.1):
            assert self.read(float(at_s)) is not None

    def correct(self, at_s: float, now_s: float, x: float = 4.0) -> RobotCorrection | None:
        pose = Pose.planar(x, 0.0, 0.0)
        message = PoseEstimate(UNIX_NS + to_ns(at_s), "map", pose, np.eye(6) * 1e-4)
        return self.bridge.on_correction(message, CorrectionMark(MAP, 1), to_ns(now_s))


@pytest.fixture
def robot() -> Robot:
    robot = Robot()
    robot.connect()
    return robot


def test_odometry_is_stamped_in_unix_time_of_the_reading(robot: Robot) -> None:
    message = robot.read(3.0)
    assert message is not None
    assert abs(message.stamp_ns - UNIX_NS - to_ns(3.0)) < 1000
    assert robot.health.total("odometry") == 1


def test_odometry_before_the_clock_is_known_is_not_published() -> None:
    robot = Robot()
    robot.bridge.on_event(Connected("r1", "test", 1))
    assert robot.read(3.0) is None
    assert robot.health.total("odometry_before_clock") == 1


def test_clock_that_jumps_ahead_costs_the_readings_until_it_is_known(
    robot: Robot,
) -> None:
    robot.stand(1.0, 2.0)
    ahead_ns = to_ns(3600.0)
    assert robot.read_firmware(to_ns(2.0) + FIRMWARE_NS + ahead_ns, 2.0) is None
    assert robot.health.lost("odometry_ahead_of_clock") == 1
    for k in range(8):
        middle_ns, way_ns = to_ns(2.1 + 0.02 * k), to_ns(0.0001)
        robot.bridge.on_event(
            ClockExchange(
                middle_ns - way_ns, middle_ns + FIRMWARE_NS + ahead_ns, middle_ns + way_ns
            )
        )
    message = robot.read_firmware(to_ns(2.5) + FIRMWARE_NS + ahead_ns, 2.5)
    assert message is not None
    assert abs(message.stamp_ns - UNIX_NS - to_ns(2.5)) < 1000


def test_correction_goes_on_with_the_firmwares_time_and_a_number(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    handed_on = robot.correct(1.55, 1.7)
    assert handed_on is not None
    assert abs(handed_on.firmware_ns - FIRMWARE_NS - to_ns(1.55)) < 1000
    assert (handed_on.number, handed_on.map_id, handed_on.establishes) == (1, MAP, True)
    assert robot.health.total("frames_established") == 1


def test_refused_corrections_are_counted_by_reason_and_the_first_of_a_run_is_told(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    robot.stand(1.0, 4.0)
    assert robot.correct(1.0, 3.9) is None
    assert robot.correct(1.1, 3.9) is None
    assert robot.health.lost("corrections_refused_too_old") == 2
    [told] = caplog.messages
    assert told.startswith("a correction for robot r1 was refused: it is 2.90 s old")


def test_correction_while_nobody_is_there_is_refused_and_leaves_no_trace(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    robot.bridge.on_event(Mismatched("another robot"))
    assert robot.correct(1.5, 1.9) is None
    assert robot.health.lost("corrections_refused_not_connected") == 1
    robot.bridge.on_event(Connected("r1", "test", 1))
    handed_on = robot.correct(1.5, 1.9)
    assert handed_on is not None
    assert handed_on.establishes


def test_restarted_firmware_is_told_and_its_odometry_goes_on(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    assert robot.correct(1.5, 1.9) is not None
    robot.connect(boot=2, at_s=4.0)
    message = robot.read(5.0, x=0.0)
    assert message is not None
    assert message.pose.translation[0] == 1.0
    assert robot.health.lost("firmware_restarts") == 1
    assert "was restarted" in robot.health.last_error
    robot.read(5.1, x=0.0)
    handed_on = robot.correct(5.05, 5.2, x=9.0)
    assert handed_on is not None
    assert handed_on.establishes


def test_same_firmware_after_an_unplug_is_no_restart(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    robot.connect(boot=1, at_s=4.0)
    message = robot.read(5.0, x=1.5)
    assert message is not None
    assert message.pose.translation[0] == 1.5
    assert robot.health.lost("firmware_restarts") == 0


def test_everything_that_goes_wrong_is_counted(robot: Robot) -> None:
    for event in (
        Damaged(DamageKind.CHECKSUM),
        Damaged(DamageKind.FRAMING),
        Missing(4),
        Unanswered(1),
        Acknowledged(2, True, "", to_ns(0.002)),
        Acknowledged(3, False, "too old", to_ns(0.003)),
        Vitals(10, 2),
    ):
        robot.bridge.on_event(event)
    health = robot.health
    assert health.lost("serial_checksum_errors") == health.lost("serial_framing_errors") == 1
    assert health.lost("serial_frames_missing") == 4
    assert health.lost("corrections_unanswered") == 1
    assert health.total("corrections_accepted") == 1
    assert health.lost("corrections_refused_by_robot") == 1
    assert robot.bridge.answer_ms == 3.0
    assert robot.bridge.vitals == Vitals(10, 2)
    assert health.last_error == "robot r1 refused a correction: too old"


def test_silent_robot_is_told(robot: Robot) -> None:
    robot.bridge.on_event(Silent())
    assert robot.health.last_error == "robot r1 is silent; is it on, and is `baud` right?"


def test_reading_with_an_earlier_time_is_counted_and_left_out(robot: Robot) -> None:
    robot.read(2.0)
    assert robot.read(1.9) is None
    assert robot.health.lost("odometry_out_of_order") == 1
