"""The bridge's interface to a robot's protocol: bytes in, events out; commands in, bytes out.

A protocol does no input or output and reads no clock: the owner of the port passes it bytes with
their time of arrival, and asks it what to send. Times named `now_ns` are this machine's monotonic
clock, `firmware_ns` the firmware's own clock.

To add a protocol, add a row to `PROTOCOLS`, or let another package offer an entry point in the
group `trigpoint.protocols`; both name a class that is built from a `Setup`.
"""

import importlib
import typing
from collections.abc import Callable
from enum import StrEnum
from importlib.metadata import entry_points
from uuid import UUID

from msgspec import Struct

from trigpoint.base.errors import ConfigError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import ROS2_PROTOCOL, RobotConfig

PROTOCOLS = {
    "trigpoint": "trigpoint.robot.line.protocols.trigpoint_serial:TrigpointSerial",
    "create2": "trigpoint.robot.line.protocols.create2:Create2",
    "mavlink": "trigpoint.robot.line.protocols.mavlink:Mavlink",
    "ros_arduino_bridge": "trigpoint.robot.line.protocols.ros_arduino_bridge:RosArduinoBridge",
}
ENTRY_POINTS = "trigpoint.protocols"


class Setup(Struct, frozen=True):
    """The arguments from which a protocol is built.

    `boot`: a number that no earlier bridge of this robot had; `unix_ns`: when this one started;
    `key`: 32 bytes for signing what is sent, b"" if the site file names none.
    """

    robot: str
    config: RobotConfig
    boot: int
    unix_ns: int = 0
    key: bytes = b""


class Takes(StrEnum):
    """What a protocol can send to its robot."""

    CORRECTIONS = "corrections"
    POSES = "poses"
    NOTHING = "nothing"


class StampClock(StrEnum):
    """The clock of `Reading.firmware_ns`: the firmware's own, which clock exchanges map to ours;
    this machine's monotonic one, if the protocol carries no times; or Unix time."""

    FIRMWARE = "firmware"
    MACHINE = "machine"
    UNIX = "unix"


class Traits(Struct, frozen=True):
    """What a protocol can carry. `lacks`: what it cannot, in words, logged at the start."""

    takes: Takes
    clock: StampClock
    lacks: tuple[str, ...] = ()


class Connected(Struct, frozen=True):
    """The robot identified itself. `boot` differs each time its firmware starts."""

    robot: str
    firmware: str
    boot: int


class Mismatched(Struct, frozen=True):
    """The device that answered cannot be used; `text` says why and what to do."""

    text: str


class Reading(Struct, frozen=True):
    """One reading of the odometry: base in the firmware's own odometry frame. `firmware_ns`: by the
    clock that the protocol's traits name; `received_ns`: this machine's monotonic clock on
    arrival; `doubt_ns`: how much earlier or later than `firmware_ns` it may have been taken, where
    the protocol knows that."""

    firmware_ns: int
    received_ns: int
    pose: Pose
    linear: Array
    angular: Array
    doubt_ns: int = 0


class ClockExchange(Struct, frozen=True):
    """The firmware's clock read `firmware_ns` at some time between `sent_ns` and `received_ns`: in
    the middle, if both directions take equally long."""

    sent_ns: int
    firmware_ns: int
    received_ns: int


class Acknowledged(Struct, frozen=True):
    """The firmware answered a correction; `reason` is "" if it was accepted."""

    number: int
    is_accepted: bool
    reason: str
    round_trip_ns: int


class Unanswered(Struct, frozen=True):
    """A correction that was not answered, although it was repeated."""

    number: int


class Vitals(Struct, frozen=True):
    """The firmware's own counts since it started."""

    received: int
    rejected: int


class DamageKind(StrEnum):
    """What was wrong with received bytes."""

    FRAMING = "framing"
    CHECKSUM = "checksum"
    CONTENT = "content"


class Damaged(Struct, frozen=True):
    """Received bytes that were discarded. `text`: what they were and what to do, where more than
    noise on the line must be wrong."""

    kind: DamageKind
    text: str = ""


class Missing(Struct, frozen=True):
    """Frames that were sent but did not arrive, by their sequence numbers."""

    frames: int


class Silent(Struct, frozen=True):
    """Nothing arrived for a while; the protocol asks again who is there."""


class Advice(Struct, frozen=True):
    """What is used as it comes, but had better be written in the site file."""

    text: str


Event = (
    Connected
    | Advice
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


class RobotCorrection(Struct, frozen=True):
    """A correction as sent to a robot: the pose of its base when its own clock read `firmware_ns`.

    `covariance`: (6, 6), as in the contract; `establishes`: the pose may be anywhere, because it is
    the first in a map or because a run of corrections contradicted the earlier ones.
    """

    number: int
    firmware_ns: int
    map_id: UUID
    sequence: int
    map_from_base: Pose
    covariance: Array
    establishes: bool


class LocatedPose(Struct, frozen=True):
    """A robot's current pose, for protocols that take poses. `firmware_ns`: by their clock;
    `covariance`: (6, 6), as in the contract; `resets`: how often the robot was placed anew."""

    firmware_ns: int
    map_from_base: Pose
    covariance: Array
    resets: int


class Protocol(typing.Protocol):
    """The conversation with one robot. Not thread-safe: the owner locks around each call."""

    @property
    def traits(self) -> Traits:
        """What the protocol can carry."""
        ...

    def reset(self) -> None:
        """The port was (re)opened: discard partial frames, ask again who is there."""
        ...

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """The events in the bytes, in order. Never raises, whatever the bytes are."""
        ...

    def correct(self, correction: RobotCorrection) -> None:
        """Send this correction next; one still waiting is replaced, as the newest wins."""
        ...

    def locate(self, pose: LocatedPose) -> None:
        """Send the robot its current pose; only if the traits say that it takes poses."""
        ...

    def data_to_send(self, now_ns: int) -> bytes:
        """Everything due now; write it at once, as it may contain time stamps."""
        ...

    def due_ns(self, now_ns: int) -> int:
        """When `data_to_send` will next have something; `now_ns` or earlier if it has now."""
        ...

    def elapse(self, now_ns: int) -> list[Event]:
        """Events caused by the passing of time: silence, unanswered corrections."""
        ...


def known_protocols() -> list[str]:
    """The protocol names that site.toml may use on this machine."""
    others = (point.name for point in entry_points(group=ENTRY_POINTS))
    return sorted({*PROTOCOLS, ROS2_PROTOCOL, *others})


def make_protocol(setup: Setup) -> Protocol:
    """The protocol that the site file names for a robot."""
    return protocol_class(setup.config.protocol_name)(setup)


def check_protocol(config: RobotConfig) -> None:
    """Raise ConfigError if the site file names an unknown protocol."""
    if config.protocol_name != ROS2_PROTOCOL:
        protocol_class(config.protocol_name)


def protocol_class(name: str) -> Callable[[Setup], Protocol]:
    """The protocol's class; raise a ConfigError that lists the known ones."""
    if name in PROTOCOLS:
        module, _, attribute = PROTOCOLS[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
    for point in entry_points(group=ENTRY_POINTS, name=name):
        return point.load()
    known = ", ".join(known_protocols())
    raise ConfigError(f"there is no robot protocol «{name}»; site.toml may name {known}")


def readable(line: bytes) -> str:
    """A line for people, without blanks around it; what is not printable is escaped."""
    text = line.decode("ascii", "backslashreplace").replace("\t", " ").strip()
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)
