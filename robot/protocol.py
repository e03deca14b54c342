"""What the bridge sees of a robot's protocol: bytes in, events out; commands in, bytes out.

A protocol does no input or output and reads no clock: whoever owns the port hands it bytes with
the time at which they came, and asks it what to send. Times named `now_ns` are this machine's
monotonic clock, `firmware_ns` the firmware's own clock.

To add a protocol, add a row to `PROTOCOLS`, or let another package offer an entry point in the
group `trigpoint.protocols`; both name a class that is built from a `Setup`.
"""

import importlib
import typing
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import entry_points
from uuid import UUID

from trigpoint.config import ROS2_PROTOCOL, RobotConfig
from trigpoint.errors import ConfigError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

PROTOCOLS = {
    "trigpoint": "trigpoint.robot.protocols.trigpoint_serial:TrigpointSerial",
    "create2": "trigpoint.robot.protocols.create2:Create2",
    "mavlink": "trigpoint.robot.protocols.mavlink:Mavlink",
    "ros_arduino_bridge": "trigpoint.robot.protocols.ros_arduino_bridge:RosArduinoBridge",
}
ENTRY_POINTS = "trigpoint.protocols"


@dataclass(frozen=True, slots=True)
class Setup:
    """What a protocol is built from.

    `boot`: a number that no earlier bridge of this robot had; `unix_ns`: when this one began;
    `key`: 32 bytes that sign what is sent, b"" where the site file names none.
    """

    robot: str
    config: RobotConfig
    boot: int
    unix_ns: int = 0
    key: bytes = b""


class Takes(StrEnum):
    """What a protocol can tell its robot."""

    CORRECTIONS = "corrections"
    POSES = "poses"
    NOTHING = "nothing"


class StampClock(StrEnum):
    """Which clock `Reading.firmware_ns` is of: the firmware's own, which clock exchanges map to
    ours; this machine's monotonic one, where the protocol has no times; or Unix time."""

    FIRMWARE = "firmware"
    MACHINE = "machine"
    UNIX = "unix"


@dataclass(frozen=True, slots=True)
class Traits:
    """What a protocol can carry. `lacks`: what it cannot, in words, said at the start."""

    takes: Takes
    clock: StampClock
    lacks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Connected:
    """The robot said who it is. `boot` differs each time its firmware starts."""

    robot: str
    firmware: str
    boot: int


@dataclass(frozen=True, slots=True)
class Mismatched:
    """Whoever answers cannot be worked with; `text` says why and what to do."""

    text: str


@dataclass(frozen=True, slots=True)
class Reading:
    """One reading of the odometry: base in the firmware's own odometry frame. `firmware_ns`: by the
    clock that the protocol's traits name; `received_ns`: this machine's monotonic clock when it
    had come."""

    firmware_ns: int
    received_ns: int
    pose: Pose
    linear: Array
    angular: Array


@dataclass(frozen=True, slots=True)
class ClockExchange:
    """The firmware's clock read `firmware_ns` at some time between `sent_ns` and `received_ns`,
    as near to the middle as both ways take the same time."""

    sent_ns: int
    firmware_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """The firmware answered a correction; `reason` is "" where it was accepted."""

    number: int
    is_accepted: bool
    reason: str
    round_trip_ns: int


@dataclass(frozen=True, slots=True)
class Unanswered:
    """A correction that no answer came to, though it was repeated."""

    number: int


@dataclass(frozen=True, slots=True)
class Vitals:
    """What the firmware counted on its side since it started."""

    received: int
    rejected: int


class DamageKind(StrEnum):
    """What was wrong with bytes that came."""

    FRAMING = "framing"
    CHECKSUM = "checksum"
    CONTENT = "content"


@dataclass(frozen=True, slots=True)
class Damaged:
    """Bytes that were thrown away."""

    kind: DamageKind


@dataclass(frozen=True, slots=True)
class Missing:
    """Frames that were sent and did not arrive, by their sequence numbers."""

    frames: int


@dataclass(frozen=True, slots=True)
class Silent:
    """Nothing came for a while; the protocol asks again who is there."""


Event = (
    Connected
    | Mismatched
    | Reading
    | ClockExchange
    | Acknowledged
    | Unanswered
    | Vitals
    | Damaged
    | Missing
    | Silent
)


@dataclass(frozen=True, slots=True)
class RobotCorrection:
    """What a robot is told: where its base was when its own clock read `firmware_ns`.

    `covariance`: (6, 6), the contract's; `establishes`: the pose may be anywhere, since it is the
    first of a map, or since a run of corrections contradicted those before it.
    """

    number: int
    firmware_ns: int
    map_id: UUID
    sequence: int
    map_from_base: Pose
    covariance: Array
    establishes: bool


@dataclass(frozen=True, slots=True)
class LocatedPose:
    """Where a robot is now, for protocols that take poses: `firmware_ns` by their clock,
    `covariance` (6, 6) the contract's; `resets` counts how often the pose was placed anew."""

    firmware_ns: int
    map_from_base: Pose
    covariance: Array
    resets: int


class Protocol(typing.Protocol):
    """One robot's conversation. Not thread-safe: the owner holds a lock around each call."""

    @property
    def traits(self) -> Traits:
        """What it can carry."""
        ...

    def reset(self) -> None:
        """The port was (re)opened: forget half-received bytes, ask again who is there."""
        ...

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """What the bytes say, in order. Never raises on what the bytes are."""
        ...

    def correct(self, correction: RobotCorrection) -> None:
        """Send this correction next; one that still waits is replaced, since the newest wins."""
        ...

    def locate(self, pose: LocatedPose) -> None:
        """Tell the robot where it is now; only where the traits say that it takes poses."""
        ...

    def data_to_send(self, now_ns: int) -> bytes:
        """Everything that is due now; to be written at once, since it may hold time stamps."""
        ...

    def due_ns(self, now_ns: int) -> int:
        """When `data_to_send` has something next; `now_ns` or earlier where it has now."""
        ...

    def elapse(self, now_ns: int) -> list[Event]:
        """What follows from the mere passing of time: silence, corrections without an answer."""
        ...


def known_protocols() -> list[str]:
    """The names that `protocol` in site.toml may have here."""
    others = (point.name for point in entry_points(group=ENTRY_POINTS))
    return sorted({*PROTOCOLS, ROS2_PROTOCOL, *others})


def make_protocol(setup: Setup) -> Protocol:
    """The protocol that the site file names for a robot."""
    return protocol_class(setup.config.protocol_name)(setup)


def check_protocol(config: RobotConfig) -> None:
    """Raise ConfigError where the site file names a protocol that there is not."""
    if config.protocol_name != ROS2_PROTOCOL:
        protocol_class(config.protocol_name)


def protocol_class(name: str) -> Callable[[Setup], Protocol]:
    """The protocol's class; raise ConfigError that lists what there is."""
    if name in PROTOCOLS:
        module, _, attribute = PROTOCOLS[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
    for point in entry_points(group=ENTRY_POINTS, name=name):
        return point.load()
    known = ", ".join(known_protocols())
    raise ConfigError(f"there is no robot protocol «{name}»; site.toml may name {known}")
