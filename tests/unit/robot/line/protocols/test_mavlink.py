"""MAVLink against pymavlink, the project's own library, on the autopilot's side."""

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.line.protocol import (
    ClockExchange,
    Connected,
    Damaged,
    Event,
    LocatedPose,
    Mismatched,
    Missing,
    Reading,
    Setup,
)
from trigpoint.robot.line.protocols.mavlink import Mavlink
from trigpoint.site.config import MavlinkConfig, RobotConfig, WheelConfig

NOW_NS = to_ns(10.0)
UNIX_NS = to_ns(1_764_000_000.0)
KEY = bytes(range(32))
UNKNOWN = [math.nan] * 21
# HEARTBEAT of a rover with ArduPilot (system 1, component 1) as pymavlink 2.4.50 packs it.
HEARTBEAT = bytes.fromhex("fd090000000101000000000000000a03510403bf3f")


class Autopilot:
    """Speaks and hears by pymavlink alone."""

    def __init__(self, key: bytes = b"") -> None:
        self.codec: Any = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.ears: Any = mavlink.MAVLink(None)
        for codec in (self.codec, self.ears):
            if key:
                codec.signing.secret_key = key
                codec.signing.timestamp = (UNIX_NS - 1_420_070_400 * 10**9) // 10_000
        self.codec.signing.sign_outgoing = bool(key)

    def say(self, message: Any) -> bytes:
        data = bytes(message.pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) % 256
        return data

    def hear(self, data: bytes) -> list[Any]:
        return self.ears.parse_buffer(bytearray(data)) or []

    def odometry(self, pose: Pose, stamp_us: int = 5_000_000, resets: int = 0) -> bytes:
        """`pose` in MAVLink's own axes."""
        qx, qy, qz, qw = (float(value) for value in pose.quaternion)
        x, y, z = (float(value) for value in pose.translation)
        frames = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD)
        fields: tuple[Any, ...] = (
            stamp_us, *frames, x, y, z, [qw, qx, qy, qz], 0.5, 0.1, 0, 0, 0, 0.2,
            UNKNOWN, UNKNOWN, resets, 0, 0,
        )  # fmt: skip
        return self.say(mavlink.MAVLink_odometry_message(*fields))


def opened(key: bytes = b"", send: Any = "odometry", track: float = 0.3) -> Mavlink:
    wheels, options = WheelConfig(track=track), MavlinkConfig(send=send)
    config = RobotConfig(port="x", protocol="mavlink", wheels=wheels, mavlink=options)
    return Mavlink(Setup("r1", config, 1, UNIX_NS, key))


def of_kind(events: list[Event], kind: type) -> list[Any]:
    return [event for event in events if isinstance(event, kind)]


def test_heartbeat_connects() -> None:
    events = opened().receive(HEARTBEAT, NOW_NS)
    assert of_kind(events, Connected)


def test_odometry_is_turned_from_north_east_down() -> None:
    """1 m north, 2 m east, heading 90° east of north: forward 1, right 2, turned to the right."""
    ned = Pose.planar(1.0, 2.0, math.pi / 2)
    [reading] = of_kind(opened().receive(Autopilot().odometry(ned), NOW_NS), Reading)
    expected = Pose.planar(1.0, -2.0, -math.pi / 2)
    np.testing.assert_allclose(reading.pose.difference(expected), 0, atol=1e-6)
    np.testing.assert_allclose(reading.linear, [0.5, -0.1, 0], atol=1e-6)
    np.testing.assert_allclose(reading.angular, [0, 0, -0.2], atol=1e-6)
    assert reading.firmware_ns == 5 * 10**9


def test_reset_of_the_autopilots_estimate_is_no_motion() -> None:
    protocol, autopilot = opened(), Autopilot()
    protocol.receive(autopilot.odometry(Pose.planar(3.0, 0, 0)), NOW_NS)
    moved = autopilot.odometry(Pose.planar(-8.0, 1.0, 0.5), 5_020_000, resets=1)
    [reading] = of_kind(protocol.receive(moved, NOW_NS), Reading)
    np.testing.assert_allclose(reading.pose.difference(Pose.planar(3.0, 0, 0)), 0, atol=1e-6)


def distances(stamp_us: int, left: float, right: float) -> Any:
    return mavlink.MAVLink_wheel_distance_message(stamp_us, 2, [left, right] + [0.0] * 14)


def test_wheel_distances_are_a_way_where_there_is_no_odometry() -> None:
    protocol, autopilot = opened(), Autopilot()
    found = []
    message = distances(0, 10.0, 20.0)
    for k, (left, right) in enumerate([(10.0, 20.0), (10.5, 20.5), (10.5, 20.5 + 0.3 * math.pi)]):
        message = distances(k * 20_000, left, right)
        found += of_kind(protocol.receive(autopilot.say(message), NOW_NS), Reading)
    np.testing.assert_allclose(found[1].pose.translation[0], 0.5)
    assert abs(found[2].pose.heading) == pytest.approx(math.pi)
    found = protocol.receive(autopilot.odometry(Pose.identity()), NOW_NS)
    assert of_kind(found, Reading)
    assert not of_kind(protocol.receive(autopilot.say(message), NOW_NS), Reading)


def test_wheel_distances_without_a_track_are_asked_for_by_name() -> None:
    message = mavlink.MAVLink_wheel_distance_message(0, 2, [0.0] * 16)
    events = opened(track=0.0).receive(Autopilot().say(message), NOW_NS)
    assert "write track under [robots.r1.wheels]" in of_kind(events, Mismatched)[0].text


def test_time_is_exchanged_by_timesync() -> None:
    protocol, autopilot = opened(), Autopilot()
    protocol.receive(HEARTBEAT, NOW_NS)
    syncs = [m for m in autopilot.hear(protocol.data_to_send(NOW_NS)) if m.get_type() == "TIMESYNC"]
    assert [(sync.tc1, sync.ts1) for sync in syncs] == [(0, NOW_NS)]
    answer = mavlink.MAVLink_timesync_message(to_ns(77.0), NOW_NS)
    events = protocol.receive(autopilot.say(answer), NOW_NS + to_ns(0.004))
    exchanged = ClockExchange(NOW_NS, to_ns(77.0), NOW_NS + to_ns(0.004))
    assert of_kind(events, ClockExchange) == [exchanged]
    assert not of_kind(protocol.receive(autopilot.say(answer), NOW_NS), ClockExchange)


def located(resets: int = 3) -> LocatedPose:
    covariance = np.zeros((6, 6))
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = [
        [4e-4, 1e-4, 2e-5],
        [1e-4, 9e-4, 0],
        [2e-5, 0, 1e-4],
    ]
    return LocatedPose(to_ns(5.0), Pose.planar(1.0, 2.0, 0.3), covariance, resets)


def said(protocol: Mavlink, autopilot: Autopilot, kind: str) -> list[Any]:
    protocol.receive(autopilot.say(mavlink.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3)), NOW_NS)
    found = []
    for k in range(40):
        protocol.locate(located())
        heard = autopilot.hear(protocol.data_to_send(NOW_NS + to_ns(0.025) * k))
        found += [message for message in heard if message.get_type() == kind]
    return found


def test_pose_is_said_as_odometry_in_forward_right_down() -> None:
    found = said(opened(), Autopilot(), "ODOMETRY")
    assert len(found) >= 9  # in a second; four are needed
    message = found[0]
    assert (message.frame_id, message.child_frame_id) == (20, 12)
    assert (message.x, message.y, message.z) == pytest.approx((1.0, -2.0, 0.0))
    assert message.q == pytest.approx([math.cos(0.15), 0, 0, -math.sin(0.15)], abs=1e-6)
    # Upper triangle of x, y, z, roll, pitch, yaw: xy and x-yaw change their signs.
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = message.pose_covariance
    assert covariance[0, 1] == pytest.approx(-1e-4)
    assert covariance[0, 5] == pytest.approx(-2e-5)
    assert np.diag(covariance)[[0, 1, 5]] == pytest.approx([4e-4, 9e-4, 1e-4])
    assert message.reset_counter == 3
    assert message.time_usec == 5_000_000


def test_pose_is_said_as_vision_position_where_that_is_configured() -> None:
    message = said(opened(send="vision"), Autopilot(), "VISION_POSITION_ESTIMATE")[0]
    assert (message.x, message.y, message.yaw) == pytest.approx((1.0, -2.0, -0.3))
    assert message.covariance[0] == pytest.approx(4e-4)
    assert message.reset_counter == 3


def test_signed_line_takes_signed_frames_alone() -> None:
    protocol, signing, silent = opened(KEY), Autopilot(KEY), Autopilot()
    assert not of_kind(protocol.receive(silent.odometry(Pose.identity()), NOW_NS), Reading)
    wrong = Autopilot(bytes(32))
    assert not of_kind(protocol.receive(wrong.odometry(Pose.identity()), NOW_NS), Reading)
    frame = signing.odometry(Pose.identity())
    assert of_kind(protocol.receive(frame, NOW_NS), Reading)
    assert not of_kind(protocol.receive(frame, NOW_NS), Reading)  # replayed
    assert said(protocol, signing, "ODOMETRY")  # which takes signed ones alone


def test_other_systems_and_our_own_words_are_not_heard() -> None:
    protocol, other = opened(), Autopilot()
    other.codec.srcSystem = 9
    assert protocol.receive(other.odometry(Pose.identity()), NOW_NS) == []
    other.codec.srcSystem, other.codec.srcComponent = 1, 197
    assert protocol.receive(other.odometry(Pose.identity()), NOW_NS) == []


def test_lost_frames_are_counted_by_their_numbers() -> None:
    protocol, autopilot = opened(), Autopilot()
    protocol.receive(autopilot.odometry(Pose.identity()), NOW_NS)
    autopilot.codec.seq += 4
    events = protocol.receive(autopilot.odometry(Pose.identity(), 5_020_000), NOW_NS)
    assert of_kind(events, Missing) == [Missing(4)]


def test_marker_and_length_in_garbage_hold_no_frame_back() -> None:
    protocol, autopilot = opened(), Autopilot()
    protocol.receive(HEARTBEAT, NOW_NS)
    garbage = bytes([0xFD, 255, 0]) + b"\x11" * 20
    events = protocol.receive(garbage + autopilot.odometry(Pose.identity()), NOW_NS)
    assert of_kind(events, Reading)
    assert of_kind(events, Damaged)


def test_pose_that_is_none_is_damage() -> None:
    protocol, autopilot = opened(), Autopilot()
    bad = Pose(np.eye(3), np.array([np.nan, 0, 0]))
    events = protocol.receive(autopilot.odometry(bad), NOW_NS)
    assert of_kind(events, Damaged)
    assert not of_kind(events, Reading)
