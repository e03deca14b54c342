"""The payloads of the `trigpoint` serial protocol, both directions (docs/reference/serial.md).

All numbers are little-endian. The bridge and the firmware's side use the same code. Decoding checks
what comes: lengths, finite numbers, unit quaternions; it raises MessageError.
"""

import math
import struct
from collections.abc import Callable
from enum import IntEnum
from uuid import UUID

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import MessageError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, of_quaternion
from trigpoint.robot.line.wheels import WheelGeometry

VERSION = 1
MAXIMUM_TEXT = 64

# The covariance travels as its upper triangle over x, y, heading.
_SHOWN = [0, 1, 5]
_UPPER = np.triu_indices(3)


class Kind(IntEnum):
    """The first byte of a frame."""

    HELLO = 1
    ODOMETRY = 2
    PING = 3
    PONG = 4
    CORRECTION = 5
    ACKNOWLEDGE = 6
    HEARTBEAT = 7
    TICKS = 8


class Result(IntEnum):
    """A firmware's answer to a correction."""

    ACCEPTED = 0
    TOO_OLD = 1
    JUMP = 2
    INVALID = 3
    BUSY = 4


class Hello(Struct, frozen=True):
    """Who speaks. Its layout is the same in every version, so that a wrong one can be named."""

    version: int
    boot: int
    name: str
    program: str


class OdometryFrame(Struct, frozen=True):
    """One odometry reading; `odom_from_base`, twist in the base frame."""

    boot: int
    stamp_ns: int
    pose: Pose
    linear: Array
    angular: Array


class TicksFrame(Struct, frozen=True):
    """One reading of a differential drive's two wheel counters, in place of OdometryFrame."""

    boot: int
    stamp_ns: int
    left: int
    right: int
    geometry: WheelGeometry


class Ping(Struct, frozen=True):
    """The bridge asks for the firmware's time."""

    number: int


class Pong(Struct, frozen=True):
    """The firmware's clock when the ping's last byte came and when this frame was handed out."""

    number: int
    boot: int
    received_ns: int
    sent_ns: int


class CorrectionFrame(Struct, frozen=True):
    """`map_from_base` at `stamp_ns` of the firmware's clock; `covariance`: (3, 3) over x, y,
    heading."""

    number: int
    establishes: bool
    stamp_ns: int
    map_id: UUID
    sequence: int
    pose: Pose
    covariance: Array


class Acknowledge(Struct, frozen=True):
    """The answer to a correction; `result` may be a number that `Result` does not know yet."""

    number: int
    result: int
    text: str


class Heartbeat(Struct, frozen=True):
    """Sent once a second both ways; counters since the sender's start, modulo 2³²."""

    uptime_ns: int
    received: int
    rejected: int


Content = (
    Hello | OdometryFrame | TicksFrame | Ping | Pong | CorrectionFrame | Acknowledge | Heartbeat
)

_HELLO = struct.Struct("<HI")
_ODOMETRY = struct.Struct("<IQ7d6f")
_TICKS = struct.Struct("<IQIIB3f")
_PING = struct.Struct("<I20x")
_PONG = struct.Struct("<IIQQ")
_CORRECTION = struct.Struct("<IBQ16sQ7d6f")
_ACKNOWLEDGE = struct.Struct("<IB")
_HEARTBEAT = struct.Struct("<QII")


def encode_payload(content: Content) -> tuple[Kind, bytes]:
    """The frame's kind and payload."""
    match content:
        case Hello():
            head = _HELLO.pack(content.version, content.boot)
            return Kind.HELLO, head + _text(content.name) + _text(content.program)
        case OdometryFrame():
            return Kind.ODOMETRY, _encode_odometry(content)
        case TicksFrame():
            return Kind.TICKS, _encode_ticks(content)
        case Ping():
            return Kind.PING, _PING.pack(content.number)
        case Pong():
            times = (content.received_ns, content.sent_ns)
            return Kind.PONG, _PONG.pack(content.number, content.boot, *times)
        case CorrectionFrame():
            return Kind.CORRECTION, _encode_correction(content)
        case Acknowledge():
            head = _ACKNOWLEDGE.pack(content.number, content.result)
            return Kind.ACKNOWLEDGE, head + _text(content.text)
        case Heartbeat():
            counters = (content.received % 2**32, content.rejected % 2**32)
            return Kind.HEARTBEAT, _HEARTBEAT.pack(content.uptime_ns, *counters)


def decode_payload(kind: int, payload: bytes) -> Content:
    """What a frame says; raise MessageError where the kind is unknown or the payload unsound."""
    if kind not in _DECODERS:
        raise MessageError(f"a serial frame of unknown kind {kind}")
    try:
        return _DECODERS[Kind(kind)](payload)
    except (struct.error, UnicodeDecodeError) as reason:
        raise MessageError(f"a {Kind(kind).name} frame does not decode: {reason}") from None


def _encode_odometry(content: OdometryFrame) -> bytes:
    return _ODOMETRY.pack(
        content.boot,
        content.stamp_ns,
        *content.pose.translation,
        *content.pose.quaternion,
        *content.linear,
        *content.angular,
    )


def _decode_odometry(payload: bytes) -> OdometryFrame:
    boot, stamp_ns, *numbers = _ODOMETRY.unpack(payload)
    pose, twist = _pose(numbers[:7]), _finite(numbers[7:], "a twist")
    return OdometryFrame(boot, stamp_ns, pose, twist[:3], twist[3:])


def _encode_ticks(content: TicksFrame) -> bytes:
    wheels = content.geometry
    counters = (content.left % 2**32, content.right % 2**32, wheels.bits)
    metres = (wheels.left_m, wheels.right_m, wheels.track_m)
    return _TICKS.pack(content.boot, content.stamp_ns, *counters, *metres)


def _decode_ticks(payload: bytes) -> TicksFrame:
    boot, stamp_ns, left, right, bits, *numbers = _TICKS.unpack(payload)
    left_m, right_m, track_m = (float(value) for value in _finite(numbers, "a wheel geometry"))
    if bits not in (16, 32):
        raise MessageError(f"wheel counters in a serial frame wrap at {bits} bits, not 16 or 32")
    if not (left_m and right_m and track_m > 0):
        raise MessageError("a wheel geometry in a serial frame holds a zero")
    geometry = WheelGeometry(left_m, right_m, track_m, bits)
    return TicksFrame(boot, stamp_ns, left, right, geometry)


def _encode_correction(content: CorrectionFrame) -> bytes:
    return _CORRECTION.pack(
        content.number,
        int(content.establishes),
        content.stamp_ns,
        content.map_id.bytes,
        content.sequence,
        *content.pose.translation,
        *content.pose.quaternion,
        *content.covariance[_UPPER],
    )


def _decode_correction(payload: bytes) -> CorrectionFrame:
    number, flags, stamp_ns, map_id, sequence, *numbers = _CORRECTION.unpack(payload)
    pose, upper = _pose(numbers[:7]), _finite(numbers[7:], "a covariance")
    covariance = np.zeros((3, 3))
    covariance[_UPPER] = upper
    covariance = covariance + np.triu(covariance, 1).T
    establishes = bool(flags & 1)
    return CorrectionFrame(
        number, establishes, stamp_ns, UUID(bytes=map_id), sequence, pose, covariance
    )


def _decode_hello(payload: bytes) -> Hello:
    version, boot = _HELLO.unpack_from(payload)
    if version != VERSION:
        # Another version may go on as it likes after these two numbers.
        return Hello(version, boot, "", "")
    name, rest = _take_text(payload[_HELLO.size :])
    program, rest = _take_text(rest)
    _expect_end(rest)
    return Hello(version, boot, name, program)


def _decode_ping(payload: bytes) -> Ping:
    return Ping(*_PING.unpack(payload))


def _decode_pong(payload: bytes) -> Pong:
    return Pong(*_PONG.unpack(payload))


def _decode_acknowledge(payload: bytes) -> Acknowledge:
    number, result = _ACKNOWLEDGE.unpack_from(payload)
    text, rest = _take_text(payload[_ACKNOWLEDGE.size :])
    _expect_end(rest)
    return Acknowledge(number, result, text)


def _decode_heartbeat(payload: bytes) -> Heartbeat:
    return Heartbeat(*_HEARTBEAT.unpack(payload))


_DECODERS: dict[Kind, Callable[[bytes], Content]] = {
    Kind.HELLO: _decode_hello,
    Kind.ODOMETRY: _decode_odometry,
    Kind.PING: _decode_ping,
    Kind.PONG: _decode_pong,
    Kind.CORRECTION: _decode_correction,
    Kind.ACKNOWLEDGE: _decode_acknowledge,
    Kind.HEARTBEAT: _decode_heartbeat,
    Kind.TICKS: _decode_ticks,
}


def shown_covariance(covariance: Array) -> Array:
    """The (3, 3) over x, y, heading of the contract's (6, 6)."""
    return covariance[np.ix_(_SHOWN, _SHOWN)]


def _text(text: str) -> bytes:
    """A length byte and UTF-8, cut at a character's border to `MAXIMUM_TEXT` bytes."""
    encoded = text.encode()[:MAXIMUM_TEXT].decode(errors="ignore").encode()
    return bytes([len(encoded)]) + encoded


def _take_text(data: bytes) -> tuple[str, bytes]:
    length = data[0] if data else MAXIMUM_TEXT + 1
    if length > MAXIMUM_TEXT or len(data) < 1 + length:
        raise MessageError("a text in a serial frame is cut off or too long")
    return data[1 : 1 + length].decode(), data[1 + length :]


def _expect_end(rest: bytes) -> None:
    if rest:
        raise MessageError(f"a serial frame has {len(rest)} bytes too many")


def _finite(numbers: list[float], what: str) -> Array:
    if not all(map(math.isfinite, numbers)):
        raise MessageError(f"{what} in a serial frame holds a number that is not finite")
    return np.array(numbers)


def _pose(numbers: list[float]) -> Pose:
    array = _finite(numbers, "a pose")
    if abs(math.hypot(*numbers[3:]) - 1) > 1e-3:
        raise MessageError("an orientation in a serial frame is no unit quaternion")
    return Pose(of_quaternion(*numbers[3:]), array[:3])
