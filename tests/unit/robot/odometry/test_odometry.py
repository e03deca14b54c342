"""Readings become messages; looking up a moment."""

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose
from trigpoint.robot.line.protocol import Reading
from trigpoint.robot.odometry.odometry import OdometryStream, Stamped
from trigpoint.robot.odometry.recent import OdometryHistory
from trigpoint.site.config import OdometryNoise


def reading(x: float, heading: float = 0.0) -> Reading:
    return Reading(0, 0, Pose.planar(x, 0.0, heading), np.array([0.5, 0, 0]), np.zeros(3))


def taken(stream: OdometryStream, x: float, stamp_ns: int) -> Odometry:
    message = stream.add(reading(x), stamp_ns)
    assert message is not None
    return message


def test_message_names_the_robots_frames_and_carries_pose_and_twist() -> None:
    message = taken(OdometryStream("r1"), 2.0, 10)
    assert (message.frame_id, message.child_frame_id) == ("r1/odom", "r1/base")
    assert message.stamp_ns == 10
    assert message.pose.translation.tolist() == [2, 0, 0]
    assert message.linear.tolist() == [0.5, 0, 0]


def test_reading_that_is_not_newer_is_left_out() -> None:
    stream = OdometryStream("r1")
    taken(stream, 1.0, 10)
    assert stream.add(reading(2.0), 10) is None
    assert stream.last is not None
    assert stream.last.odom_from_base.translation[0] == 1.0


def test_odometry_goes_on_without_a_jump_when_the_counters_restart() -> None:
    stream = OdometryStream("r1")
    stream.add(reading(3.0, np.pi / 2), 10)
    stream.restart()
    first = taken(stream, 0.0, 20)
    np.testing.assert_allclose(first.pose.translation, [3, 0, 0], atol=1e-12)
    second = taken(stream, 0.5, 30)  # forward is now along y
    np.testing.assert_allclose(second.pose.translation, [3, 0.5, 0], atol=1e-12)


def test_restart_before_anything_was_published_changes_nothing() -> None:
    stream = OdometryStream("r1")
    stream.restart()
    assert taken(stream, 3.0, 10).pose.translation[0] == 3.0


def history() -> OdometryHistory:
    entries = OdometryHistory(1.0, OdometryNoise())
    for k in range(5):
        entries.add(Stamped(to_ns(0.5 * k), 7 + to_ns(0.5 * k), Pose.planar(k, 0, 0.2 * k)))
    return entries


def test_moment_between_readings_is_interpolated_with_the_firmwares_time() -> None:
    found = history().at(to_ns(1.75))
    assert found is not None
    assert found.firmware_ns == 7 + to_ns(1.75)
    np.testing.assert_allclose(found.odom_from_base.translation, [3.5, 0, 0])
    np.testing.assert_allclose(found.odom_from_base.heading, 0.7)


def test_moment_of_a_reading_is_that_reading() -> None:
    found = history().at(to_ns(2.0))
    assert found is not None
    assert found.odom_from_base.translation[0] == 4


def test_moments_outside_of_the_history_are_unknown() -> None:
    assert history().at(to_ns(0.5)) is None  # dropped: longer ago than the span
    assert history().at(to_ns(2.1)) is None


def test_odometry_goes_on_where_a_clock_that_was_set_back_is_followed() -> None:
    stream = OdometryStream("r1")
    taken(stream, 1.0, to_ns(100.0))
    stream.shift(-to_ns(10.0))
    message = taken(stream, 1.1, to_ns(90.0) + 1)
    assert message.pose.translation[0] == 1.1
