"""The bridge without bus and port: events in, messages and corrections out, everything counted."""

import threading
from uuid import UUID

import numpy as np
import pytest

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.contract.correction import CorrectionMark
from trigpoint.contract.messages import Odometry, PoseEstimate
from trigpoint.geometry import Pose
from trigpoint.node.health import Health
from trigpoint.robot.bridge import Bridge, first_number
from trigpoint.robot.line.protocol import (
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
    StampClock,
    Takes,
    Traits,
    Unanswered,
    Vitals,
)
from trigpoint.robot.odometry.stamps import Offset, measured_offset
from trigpoint.site.config import RobotConfig, SafetyConfig

UNIX_NS = to_ns(1_700_000_000.0)
FIRMWARE_NS = to_ns(77.0)
MAP = UUID(int=1)


class Robot:
    """A bridge, and a robot that stands at x = 1 m; times in seconds of the machine's clock."""

    def __init__(self, blend_s: float = 0.0) -> None:
        self.health = Health(ManualClock())
        safety = SafetyConfig(establish_motion=0.0, blend=blend_s)
        config = RobotConfig(port="x", safety=safety)
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

    def place(self, begin_s: float, x: float = 4.0) -> RobotCorrection:
        """Stand for two seconds and be told where that is, often enough to be believed."""
        for k in range(20):
            at_s = begin_s + 0.1 * k
            self.read(at_s)
            if self.bridge.asks_for_map:
                self.bridge.hear_map([MAP], to_ns(at_s))
            handed_on = self.correct(at_s - 0.05, at_s, x)
            if handed_on is not None:
                return handed_on
        raise AssertionError("not placed")


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


def test_reading_was_not_taken_after_it_came(robot: Robot) -> None:
    """Where the clock is not known better, as on a busy machine, no reading is lost for it."""
    robot.stand(1.0, 2.0)
    message = robot.read_firmware(to_ns(2.0) + FIRMWARE_NS + to_ns(0.01), 2.0)
    assert message is not None
    assert message.stamp_ns == UNIX_NS + to_ns(2.0)
    assert robot.health.lost("odometry_ahead_of_clock") == 0


def test_correction_goes_on_with_the_firmwares_time_and_a_number(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    first = robot.place(2.0)
    assert (first.number, first.map_id, first.establishes) == (1, MAP, True)
    assert robot.health.total("frames_established") == 1
    robot.stand(4.0, 5.0)
    handed_on = robot.correct(4.55, 4.7)
    assert handed_on is not None
    assert abs(handed_on.firmware_ns - FIRMWARE_NS - to_ns(4.55)) < 1000
    assert (handed_on.number, handed_on.map_id, handed_on.establishes) == (2, MAP, False)


def test_waiting_for_agreement_is_no_loss_and_is_said(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    assert robot.correct(1.5, 1.9) is None
    assert robot.health.total("corrections_waiting") == 1
    values = robot.health.report().values
    assert values["localisation"].startswith("unknown: 1 agree")


def test_numbers_of_a_later_bridge_are_above_those_of_an_earlier_one() -> None:
    begin_ns = to_ns(1_764_000_000.0)
    an_hour_later = first_number(begin_ns + to_ns(3600.0))
    assert an_hour_later - first_number(begin_ns) > 3600 * 10


def test_refused_corrections_are_counted_by_reason_and_the_first_of_a_run_is_told(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    robot.stand(1.0, 4.0)
    assert robot.correct(1.0, 3.9) is None
    assert robot.correct(1.1, 3.9) is None
    assert robot.health.lost("corrections_refused_too_old") == 2
    [told] = caplog.messages
    assert told.startswith("a correction for robot r1 was refused: it is 2.90 s old")


def test_correction_is_not_taken_before_the_robot_says_so(robot: Robot) -> None:
    robot.stand(0.7, 1.0)
    robot.correct(0.85, 0.9)
    assert robot.bridge.refusal.startswith("those that come wait; its place is unknown: ")
    handed_on = robot.place(1.0)
    assert robot.bridge.refusal == "robot r1 has not answered the last"
    for is_accepted, refusal in ((False, "robot r1 refused a correction: too old"), (True, "")):
        reason = "" if is_accepted else "too old"
        robot.bridge.on_event(Acknowledged(handed_on.number, is_accepted, reason, 1))
        assert robot.bridge.refusal == refusal


def test_correction_while_nobody_is_there_is_refused_and_leaves_no_trace(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    robot.bridge.on_event(Mismatched("another robot"))
    assert robot.correct(1.5, 1.9) is None
    assert robot.health.lost("corrections_refused_not_connected") == 1
    robot.bridge.on_event(Connected("r1", "test", 1))
    assert robot.place(2.0).establishes


def test_restarted_firmware_is_told_and_its_odometry_goes_on(robot: Robot) -> None:
    robot.place(1.0)
    robot.connect(boot=2, at_s=4.0)
    message = robot.read(5.0, x=0.0)
    assert message is not None
    assert message.pose.translation[0] == 1.0
    assert robot.health.lost("firmware_restarts") == 1
    assert "was restarted" in robot.health.last_error
    assert robot.correct(4.95, 5.05) is None
    assert robot.place(5.1, x=9.0).establishes


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
    assert health.report().values["correction_answer.seconds"] == "0.005000 0 1 1"
    assert robot.bridge.vitals == Vitals(10, 2)
    assert health.last_error == "robot r1 refused a correction: too old"


def test_silent_robot_is_told(robot: Robot) -> None:
    robot.bridge.on_event(Silent())
    assert robot.health.last_error == "robot r1 is silent; is it on, and is `baud` right?"


def test_reading_with_an_earlier_time_is_counted_and_left_out(robot: Robot) -> None:
    robot.read(2.0)
    assert robot.read(1.9) is None
    assert robot.health.lost("odometry_out_of_order") == 1


def test_motion_beyond_the_robots_limits_is_refused_and_said(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    for far in (11.0, 1e300, -64.5):
        assert robot.read(2.0, x=far) is None
    assert robot.health.lost("odometry_impossible") == 3
    assert "max_speed" in robot.health.last_error
    message = robot.read(2.1)
    assert message is not None
    assert message.pose.translation[0] == 1.0


def test_count_that_began_anew_is_a_new_epoch_from_the_last_pose(robot: Robot) -> None:
    """A controller that restarted without saying so: its counters are at zero, far from before."""
    robot.stand(1.0, 2.0)
    robot.place(2.0)
    found = [robot.read(4.1 + 0.02 * k, x=-8.0 + 0.01 * k) for k in range(8)]
    assert found[:4] == [None] * 4
    poses = [message.pose.translation[0] for message in found[4:] if message is not None]
    np.testing.assert_allclose(poses, [1.0, 1.01, 1.02, 1.03], atol=1e-9)
    assert robot.health.lost("odometry_epochs") == 1
    assert robot.correct(4.2, 4.3) is None  # where it is now is not known any more
    assert robot.place(5.0).establishes


def test_gap_in_the_odometry_is_counted(robot: Robot) -> None:
    robot.stand(1.0, 2.0)
    assert robot.read(3.5, x=3.0) is not None
    assert robot.health.lost("odometry_gaps") == 1


def test_step_is_spread_where_the_site_says_so() -> None:
    robot = Robot(blend_s=1.0)
    robot.connect()
    robot.place(1.0)
    robot.stand(3.0, 4.0)
    first = robot.correct(3.55, 3.95, x=4.02)
    assert first is not None
    step = first.map_from_base.translation[0] - 4.0
    assert 0.0 < step < 0.5 * 0.02
    # What is held back is owned up to.
    assert first.covariance[0, 0] > 1e-4


def test_place_is_told_on_with_an_uncertainty_that_grows(robot: Robot) -> None:
    assert robot.bridge.locate() is None
    robot.place(1.0)
    robot.read(3.0)
    first = robot.bridge.locate()
    assert robot.bridge.locate() is None  # not due
    robot.read(10.0, x=11.0)
    later = robot.bridge.locate()
    assert first is not None
    assert later is not None
    assert later.map_from_base.translation[0] == pytest.approx(14.0, abs=1e-6)
    assert later.covariance[0, 0] > first.covariance[0, 0]
    assert first.resets == later.resets == 1


class Machine:
    """A machine's clock that somebody sets."""

    def __init__(self) -> None:
        self.unix_minus_elapsed_ns = UNIX_NS

    def now_ns(self) -> int:
        return self.elapsed_ns() + self.unix_minus_elapsed_ns

    def elapsed_ns(self) -> int:
        return to_ns(5.0)

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return event.is_set()


def test_robots_own_time_is_believed_once_this_machines_clock_is_set_right() -> None:
    machine, health = Machine(), Health(ManualClock())
    traits = Traits(Takes.NOTHING, StampClock.UNIX)
    bridge = Bridge("r1", RobotConfig(topic="/r1/odom"), health, measured_offset(machine), traits)
    bridge.on_event(Connected("r1", "test", 1))
    stamp_ns = UNIX_NS + to_ns(3605.0)
    reading = Reading(stamp_ns, to_ns(5.0), Pose.identity(), np.zeros(3), np.zeros(3))
    assert bridge.on_event(reading) is None
    assert health.lost("odometry_clock_off") == 1
    assert bridge.odometry_ahead_s == 3600.0
    machine.unix_minus_elapsed_ns += to_ns(3600.0)
    bridge.follow(machine)
    odometry = bridge.on_event(reading)
    assert odometry is not None
    assert odometry.stamp_ns == stamp_ns
