"""`[robots.NAME]`: a robot's port, target and odometry, and which corrections it accepts."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from .number_types import Count, NotNegative, Positive

ROS2_PROTOCOL = "ros2"
# Protocols that say how wide their counters are and which is which, or that send none.
_COUNTS_ARE_STATED = ("trigpoint", "create2", "mavlink", ROS2_PROTOCOL)
# NTP keeps clocks on a local network this close (chrony's documentation: well below 1 ms).
_NTP_S = 1e-3


class OdometryNoise(Struct, frozen=True, forbid_unknown_fields=True):
    """Random walk of the odometry: standard deviation per root of metres or radians travelled."""

    distance: NotNegative = 0.006
    lateral: NotNegative = 0.002
    heading_drive: NotNegative = 0.004
    heading_turn: NotNegative = 0.006
    vertical: NotNegative = 0.0
    tilt: NotNegative = 0.0
    tilt_turn: NotNegative = 0.0
    distance_scale: NotNegative = 0.0
    heading_scale: NotNegative = 0.0

    @property
    def bearable_clock_offset_s(self) -> float:
        """How far a clock may be off. The offset shifts a correction by speed times offset; this
        much is the odometry's own error in a second at 1 m/s, and at least what NTP keeps."""
        return max(self.distance, _NTP_S)


class SafetyConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Which corrections the bridge hands to the robot."""

    max_age: Positive = 1.0
    max_jump: Positive = 1.0
    max_turn: Positive = 0.5
    max_sigma: Positive = 0.2
    max_heading_sigma: Positive = 0.2
    establish_motion: NotNegative = 0.25
    blend: NotNegative = 0.0


class WheelConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """A differential drive, for protocols that send encoder counts."""

    diameter: NotNegative = 0.0
    track: NotNegative = 0.0
    ticks: NotNegative = 0.0
    left_scale: float = 1.0
    right_scale: float = 1.0
    bits: Annotated[int, Meta(ge=8, le=32)] | None = None
    order: Annotated[str, Meta(pattern="^[lr-]+$")] = "lr"

    def __post_init__(self) -> None:
        if not {"l", "r"} <= set(self.order):
            raise ValueError(
                "`order` says which count is of which wheel, like "
                '"lrlr"; it needs an l and an r (and - for a number that is no count)'
            )


class MavlinkConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How the bridge speaks MAVLink."""

    system: Annotated[int, Meta(ge=1, le=255)] = 1
    component: Annotated[int, Meta(ge=1, le=255)] = 197
    send: Literal["odometry", "vision"] = "odometry"
    key: str | None = None


class RobotConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One robot: its port, its target, and the drift of its odometry."""

    port: str | None = None
    baud: Count = 115200
    protocol: str = "trigpoint"
    topic: str | None = None
    target: str | None = None
    planar: bool = True
    max_speed: Positive = 3.0
    max_turn: Positive = 6.0
    wheels: WheelConfig = WheelConfig()
    mavlink: MavlinkConfig = MavlinkConfig()
    odometry: OdometryNoise = OdometryNoise()
    safety: SafetyConfig = SafetyConfig()

    def __post_init__(self) -> None:
        is_ros = self.protocol_name == ROS2_PROTOCOL
        if is_ros and self.port is not None:
            raise ValueError('a robot with protocol = "ros2" has no port; take one of the two away')
        if not is_ros and self.port is None:
            raise ValueError(
                f"protocol «{self.protocol}» needs a port; write one like "
                'port = "/dev/serial/by-id/…"'
            )
        if self.protocol_name in _COUNTS_ARE_STATED and (
            self.wheels.bits is not None or self.wheels.order != WheelConfig().order
        ):
            raise ValueError(
                f"`wheels.bits` and `wheels.order` are not for protocol «{self.protocol_name}», "
                "which has its own; take them away"
            )
        if self.topic is not None and not is_ros:
            raise ValueError("`topic` is for a robot on the bus; take it or `port` away")

    @property
    def place(self) -> str:
        """The port that no other robot may have; "" for none, and for one that leads nowhere."""
        return "" if self.port is None or self.port.startswith("loop://") else self.port

    @property
    def protocol_name(self) -> str:
        """The robot's protocol; without a port, the default one is replaced by ROS 2 on the bus."""
        is_on_bus = self.port is None and self.protocol == "trigpoint"
        return ROS2_PROTOCOL if is_on_bus else self.protocol
