"""MAVLink 2, as ArduPilot's and PX4's rovers speak it (pymavlink, the extra `mavlink`).

In: ODOMETRY (331), or WHEEL_DISTANCE (9000; distance[0] is the left wheel, distance[1] the right).
Out: where the robot is, ten times a second, as ODOMETRY or VISION_POSITION_ESTIMATE (102) with
covariance and reset counter, which ArduPilot's external navigation wants four times a second or
more. TIMESYNC (111) gives the autopilot's clock. MAVLink's axes are x forward, y right, z down
(FRD, NED); ours y left, z up: half a turn about x, on both sides of a pose.

Frames are found by their checksum, signatures checked and made where a key is configured; pymavlink
takes the payloads apart and knows the messages.
"""

import math
from typing import Any

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.robot.line.protocol import (
    ClockExchange,
    Connected,
    Damaged,
    DamageKind,
    Event,
    LocatedPose,
    Mismatched,
    Missing,
    Reading,
    RobotCorrection,
    Setup,
    Silent,
    StampClock,
    Takes,
    Traits,
)
from trigpoint.robot.line.wheels import WheelOdometry

from .mavlink_frames import MavlinkReader, dialect, wire

LOCAL_NED, LOCAL_FRD, BODY_FRD = 1, 20, 12
HEARTBEAT_EVERY_NS = to_ns(1.0)
SEND_EVERY_NS = to_ns(0.1)
FIRST_SYNCS = 10
FIRST_SYNCS_EVERY_NS = to_ns(0.02)
SYNC_EVERY_NS = to_ns(0.5)
SILENCE_NS = to_ns(3.0)
READING_EVERY_US = 20_000
_SYNCS_KEPT = 16
_SET_MESSAGE_INTERVAL = 511
_ONBOARD_CONTROLLER, _NO_AUTOPILOT, _ACTIVE = 18, 8, 4
_HALF_TURN = np.diag([1.0, -1.0, -1.0])
_BOTH_HALVES = np.diag([1.0, -1.0, -1.0] * 2)
_UPPER = np.triu_indices(6)
_VISION = 2  # MAV_ESTIMATOR_TYPE_VISION


def turned(pose: Pose) -> Pose:
    """A pose between x forward, y left, z up and x forward, y right, z down, either way."""
    return Pose(_HALF_TURN @ pose.rotation @ _HALF_TURN, _HALF_TURN @ pose.translation)


def turned_covariance(covariance: Array) -> Array:
    """(6, 6) of it."""
    return _BOTH_HALVES @ covariance @ _BOTH_HALVES


class Mavlink:
    """The conversation with one autopilot; see `Protocol`."""

    traits = Traits(
        Takes.POSES,
        StampClock.FIRMWARE,
        (
            "MAVLink carries no map: where the robot is placed anew shows only in the reset "
            "counter; places known in another map are void then",
        ),
    )

    def __init__(self, setup: Setup) -> None:
        self._robot, self._config = setup.robot, setup.config.mavlink
        self._track_m = setup.config.wheels.track
        self._reader = MavlinkReader(setup.key)
        self._codec = wire(self._config.system, self._config.component, setup.key, setup.unix_ns)
        self._wheels = WheelOdometry()
        self._way: tuple[int, float, float] | None = None
        self._has_odometry = False
        self._resets: int | None = None
        self._odom_from_said = Pose.identity()
        self._last = Pose.identity()
        self._twist = np.zeros(6)  # of the newest reading, in MAVLink's axes
        self.reset()

    def reset(self) -> None:
        self._reader.reset()
        self._is_connected = False
        self._heard_ns: int | None = None
        self._sequence: int | None = None
        self._syncs: dict[int, int] = {}
        self._syncs_to_hurry = FIRST_SYNCS
        self._sync_due_ns = self._heartbeat_due_ns = self._send_due_ns = 0
        self._place: LocatedPose | None = None
        self._must_request = False

    # ---- what comes

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        events: list[Event] = []
        for message in self._reader.feed(data):
            events += self._message(message, now_ns)
        damaged = self._reader.take_damaged()
        return events + [Damaged(DamageKind.CHECKSUM)] * damaged

    def _message(self, message: Any, now_ns: int) -> list[Event]:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if system != self._config.system or component == self._config.component:
            return []  # of somebody else on the line, or our own word come back
        events = self._heard(message, now_ns)
        match message.get_type():
            case "ODOMETRY":
                events += self._odometry(message, now_ns)
            case "WHEEL_DISTANCE":
                events += self._wheel_distance(message, now_ns)
            case "TIMESYNC":
                events += self._time(message, now_ns)
        return events

    def _heard(self, message: Any, now_ns: int) -> list[Event]:
        events: list[Event] = []
        self._heard_ns = now_ns
        sequence = message.get_seq()
        if message.get_srcComponent() == 1:  # each component counts its own frames
            if self._sequence is not None and sequence != self._sequence:
                events.append(Missing((sequence - self._sequence) % 256))
            self._sequence = (sequence + 1) % 256
        if not self._is_connected:
            self._is_connected = self._must_request = True
            self._syncs_to_hurry, self._sync_due_ns = FIRST_SYNCS, 0
            events.append(Connected(self._robot, f"MAVLink system {self._config.system}", 0))
        return events

    def _odometry(self, message: Any, now_ns: int) -> list[Event]:
        """`odom_from_base` from one of the autopilot; its frame goes on when it resets."""
        numbers = np.array([message.x, message.y, message.z, *message.q], dtype=float)
        quaternion = numbers[[4, 5, 6, 3]]  # MAVLink's order is w, x, y, z
        if not np.all(np.isfinite(numbers)) or abs(np.linalg.norm(quaternion) - 1) > 1e-2:
            return [Damaged(DamageKind.CONTENT)]
        if message.frame_id not in (LOCAL_NED, LOCAL_FRD):
            text = (
                f"robot {self._robot} sends ODOMETRY in frame {message.frame_id}; the bridge takes "
                f"MAV_FRAME_LOCAL_NED ({LOCAL_NED}) and MAV_FRAME_LOCAL_FRD ({LOCAL_FRD})"
            )
            return [Mismatched(text)]
        self._has_odometry = True
        quaternion /= np.linalg.norm(quaternion)
        said = turned(Pose.from_quaternion(numbers[:3], quaternion))
        if self._resets is not None and message.reset_counter != self._resets:
            # The autopilot's estimate jumped; the robot did not.
            self._odom_from_said = self._last @ said.inverse()
        self._resets = message.reset_counter
        self._last = self._odom_from_said @ said
        linear = _HALF_TURN @ np.array([message.vx, message.vy, message.vz], dtype=float)
        angular = np.array([message.rollspeed, message.pitchspeed, message.yawspeed], dtype=float)
        twist = np.nan_to_num([*linear, *(_HALF_TURN @ angular)], posinf=0.0, neginf=0.0)
        return self._reading(message.time_usec * 1000, now_ns, self._last, twist[:3], twist[3:])

    def _reading(
        self, stamp_ns: int, now_ns: int, pose: Pose, linear: Array, angular: Array
    ) -> list[Event]:
        self._twist = np.concatenate([_HALF_TURN @ linear, _HALF_TURN @ angular])
        return [Reading(stamp_ns, now_ns, pose, linear, angular)]

    def _wheel_distance(self, message: Any, now_ns: int) -> list[Event]:
        if self._has_odometry:
            return []  # of the two, the one that has the heading
        if not self._track_m:
            text = (
                f"robot {self._robot} sends wheel distances; write track under "
                f"[robots.{self._robot}.wheels] in site.toml"
            )
            return [Mismatched(text)]
        left, right = (float(value) for value in message.distance[:2])
        if message.count < 2 or not (math.isfinite(left) and math.isfinite(right)):
            return [Damaged(DamageKind.CONTENT)]
        stamp_ns = message.time_usec * 1000
        before, self._way = self._way, (stamp_ns, left, right)
        if before is None:
            before = self._way
        elapsed_s = (stamp_ns - before[0]) / 1e9
        way = (left - before[1], right - before[2])
        found = self._wheels.add_way(*way, self._track_m, elapsed_s)
        return self._reading(stamp_ns, now_ns, *found)

    def _time(self, message: Any, now_ns: int) -> list[Event]:
        sent_ns = self._syncs.pop(message.ts1, None)
        if sent_ns is None or message.tc1 <= 0:
            return []
        return [ClockExchange(sent_ns, message.tc1, now_ns)]

    # ---- what goes

    def correct(self, correction: RobotCorrection) -> None:
        raise NotImplementedError("this protocol takes poses")

    def locate(self, pose: LocatedPose) -> None:
        self._place = pose

    def data_to_send(self, now_ns: int) -> bytes:
        data = bytearray()
        if now_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = now_ns + HEARTBEAT_EVERY_NS
            data += self._pack(
                dialect().MAVLink_heartbeat_message(
                    _ONBOARD_CONTROLLER, _NO_AUTOPILOT, 0, 0, _ACTIVE, 3
                )
            )
        if not self._is_connected:
            return bytes(data)
        if self._must_request:
            self._must_request = False
            data += self._requests()
        data += self._sync_if_due(now_ns)
        if self._place is not None and now_ns >= self._send_due_ns:
            self._send_due_ns = now_ns + SEND_EVERY_NS
            place, self._place = self._place, None
            data += self._pack(self._said(place))
        return bytes(data)

    def _requests(self) -> bytes:
        """Ask for both odometry messages fifty times a second; whoever knows neither says so."""
        return b"".join(
            self._pack(
                dialect().MAVLink_command_long_message(
                    self._config.system, 1, _SET_MESSAGE_INTERVAL, 0, message, READING_EVERY_US,
                    0, 0, 0, 0, 0,
                )
            )
            for message in (331, 9000)
        )  # fmt: skip

    def _sync_if_due(self, now_ns: int) -> bytes:
        if now_ns < self._sync_due_ns:
            return b""
        self._syncs_to_hurry = max(0, self._syncs_to_hurry - 1)
        pause_ns = FIRST_SYNCS_EVERY_NS if self._syncs_to_hurry else SYNC_EVERY_NS
        self._sync_due_ns = now_ns + pause_ns
        self._syncs = dict(list(self._syncs.items())[-_SYNCS_KEPT:])
        self._syncs[now_ns] = now_ns
        return self._pack(dialect().MAVLink_timesync_message(0, now_ns))

    def _said(self, place: LocatedPose) -> Any:
        pose = turned(place.map_from_base)
        x, y, z = (float(value) for value in pose.translation)
        upper = [float(value) for value in turned_covariance(place.covariance)[_UPPER]]
        stamp_us, resets = max(place.firmware_ns, 0) // 1000, place.resets % 256
        if self._config.send == "vision":
            angles = _roll_pitch_yaw(pose.rotation)
            return dialect().MAVLink_vision_position_estimate_message(
                stamp_us, x, y, z, *angles, upper, resets
            )
        qx, qy, qz, qw = (float(value) for value in pose.quaternion)
        unknown = [math.nan] * 21  # by the message's own rule the first one says so
        twist = [float(value) for value in self._twist]  # never NaN: not every autopilot looks
        return dialect().MAVLink_odometry_message(
            stamp_us, LOCAL_FRD, BODY_FRD, x, y, z, [qw, qx, qy, qz], *twist,
            upper, unknown, resets, _VISION, 100,
        )  # fmt: skip

    def _pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        return data

    def due_ns(self, now_ns: int) -> int:
        due = [self._heartbeat_due_ns]
        if self._is_connected:
            due.append(now_ns if self._must_request else self._sync_due_ns)
            if self._place is not None:
                due.append(self._send_due_ns)
        return min(due)

    def elapse(self, now_ns: int) -> list[Event]:
        if self._heard_ns is None or now_ns - self._heard_ns <= SILENCE_NS:
            return []
        self._heard_ns, self._is_connected, self._sequence = None, False, None
        return [Silent()]


def _roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """Of the rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.asin(max(-1.0, min(1.0, -float(rotation[2, 0]))))
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])
