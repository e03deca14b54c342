"""site.toml: one frozen configuration for a whole site; each node reads its own part of it."""

import math
import re
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from msgspec import Meta, Struct
from msgspec.structs import force_setattr

from .errors import ConfigError, read_text
from .geometry import CameraModel
from .toml_file import parse_toml
from .words import nearest

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(gt=0)]
Probability = Annotated[float, Meta(gt=0, lt=1)]

_Item = TypeVar("_Item")

_NAME = re.compile(r"[a-z][a-z0-9_]*")
ENDPOINT_PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
_ENDPOINT = re.compile(
    rf"(?:{'|'.join(ENDPOINT_PROTOCOLS)})/(?P<host>\[[0-9a-fA-F:.%]+\]|[^\s:/?#\[\]]+)"
    r":(?P<port>[0-9]{1,5})(?:[?#]\S*)?$"
)
# Rows that come more slowly than this make a picture that takes half a second.
_LONGEST_LINE_DELAY_S = 1e-3
# To what NTP keeps clocks on a local network (chrony's documentation: well below a millisecond).
_NTP_S = 1e-3
ROS2_PROTOCOL = "ros2"
_RTSP_OFFSET_SIGMA_S = 0.2
"""A network camera's pictures are stamped as they arrive, or by a clock that nobody has checked:
what is left of the way from exposure to arrival (0.05 to 0.5 s) is estimated."""
PICTURE_SCHEMES = ("sim", "dir", "file", "v4l2", "rtsp")


class TlsConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Mutual TLS on every link that leaves the machine; `trigpoint secure` makes the files."""

    directory: str = "secure"


class BusConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How the nodes find each other; without it, this machine alone."""

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    scouting: bool = False
    insecure: bool = False
    tls: TlsConfig | None = None

    def __post_init__(self) -> None:
        for endpoint in (*self.connect, *self.listen):
            if not _ENDPOINT.match(endpoint) or endpoint_port(endpoint) > 65535:
                raise ValueError(
                    f"«{endpoint}» is no endpoint; write one like tcp/192.168.1.10:7447 "
                    f"(with {', '.join(ENDPOINT_PROTOCOLS)})"
                )
        for endpoint in self.connect:
            if endpoint_port(endpoint) == 0:
                raise ValueError(f"«{endpoint}» has no port to connect to; write the other's port")
        if self.tls is None:
            self._check_plain()
        else:
            self._check_secured()

    def _check_plain(self) -> None:
        for endpoint in (*self.connect, *self.listen):
            if is_secured(endpoint):
                raise ValueError(f"«{endpoint}» needs certificates; write [bus.tls]")
        if self.open_doors and not self.insecure:
            raise ValueError(
                f"whoever reaches {' and '.join(self.open_doors)} can move the robots; secure the "
                "site (trigpoint secure init, [bus.tls]), or write insecure = true"
            )

    def _check_secured(self) -> None:
        if self.insecure or self.scouting:
            key = "insecure" if self.insecure else "scouting"
            raise ValueError(f"{key} = true undoes [bus.tls]; take one of the two out")
        for endpoint in (*self.connect, *self.listen):
            if not is_loopback(endpoint) and not is_secured(endpoint):
                raise ValueError(
                    f"«{endpoint}» leaves this machine in the clear; write tls/… or quic/…"
                )
            if "#" in endpoint or "?" in endpoint:
                raise ValueError(f"«{endpoint}» sets rules of its own; end it with the port")
        for endpoint in self.listen:
            if endpoint_port(endpoint) == 0:
                raise ValueError(f"«{endpoint}» has no port that others can be told; write one")

    @property
    def open_doors(self) -> tuple[str, ...]:
        """By what a neighbour on the network can get a session without a certificate."""
        if self.tls is not None:
            return ()
        doors = tuple(f"«{endpoint}»" for endpoint in self.listen if not is_loopback(endpoint))
        return (*doors, "scouting") if self.scouting else doors


class CameraConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One camera: where its pictures come from and what is known of its lens."""

    source: str
    width: Count = 640
    height: Count = 480
    rate: Positive = 10.0
    intrinsics: str | None = None
    horizontal_fov: Annotated[float, Meta(gt=0, lt=180)] = 60.0
    focal_sigma: Positive = 0.2
    centre_sigma: Positive = 0.05
    distortion_sigma: Positive = 0.5
    time_offset_sigma: NotNegative = math.nan  # the source's own, see below
    time_drift_sigma: NotNegative = 20e-6
    line_delay: float = 0.0
    picture_rate: Positive = 2.0
    picture_quality: Annotated[int, Meta(ge=1, le=100)] = 80

    def __post_init__(self) -> None:
        scheme, separator, _ = self.source.partition("://")
        if math.isnan(self.time_offset_sigma):
            usual = _RTSP_OFFSET_SIGMA_S if scheme == "rtsp" else 0.0
            force_setattr(self, "time_offset_sigma", usual)
        if not separator or not scheme:
            known = ", ".join(f"{name}://" for name in PICTURE_SCHEMES)
            raise ValueError(f"source «{self.source}» is no URL; write one of {known}")
        if not abs(self.line_delay) <= _LONGEST_LINE_DELAY_S:
            raise ValueError(
                f"line_delay is {self.line_delay:g} s from one row to the next; 30 µs is 30e-6"
            )

    @property
    def readout_s(self) -> float:
        """How much later than its first row a picture's last one is exposed, either way."""
        return abs(self.line_delay) * (self.height - 1)

    @property
    def estimates_intrinsics(self) -> bool:
        """Whether the lens is worked out from the robot's target."""
        return self.intrinsics == "estimate"

    def nominal(self) -> CameraModel:
        """The lens without distortion at the configured field of view."""
        fov_rad = math.radians(self.horizontal_fov)
        return CameraModel.from_field_of_view(self.width, self.height, fov_rad)


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
        """How far a clock may be off: it shifts a correction by speed times that, and this is as
        much as the odometry itself errs in a second at 1 m/s; at least what NTP keeps."""
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


class MavlinkConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How the bridge speaks MAVLink."""

    system: Annotated[int, Meta(ge=1, le=255)] = 1
    component: Annotated[int, Meta(ge=1, le=255)] = 197
    send: Literal["odometry", "vision"] = "odometry"
    key: str | None = None


class RobotConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One robot: its port, its target, how its odometry drifts."""

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
        if self.topic is not None and not is_ros:
            raise ValueError("`topic` is for a robot on the bus; take it or `port` away")

    @property
    def protocol_name(self) -> str:
        """What the robot speaks; one without a port and another protocol speaks on the bus."""
        is_on_bus = self.port is None and self.protocol == "trigpoint"
        return ROS2_PROTOCOL if is_on_bus else self.protocol


class PriorConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How probable it is beforehand that something else than a good sighting happened, each for one
    occasion, and the room of places.

    `wrong_sighting`: a sighting that shows something else than its robot as it stands;
    `wild_corner`: a good corner that is so far from where the others put it that it is left out;
    `disturbed`: somebody carried a robot or moved a camera in the session at all; `event`: in such
    a session, the robot is put down elsewhere between two visits, or a camera is moved between two
    visits to it (whoever meddles once is likely to do it again); `noise`: the noise is far
    otherwise than stated, in a session that does not tell; `room`: lengths (m) of the box in which
    cameras hang and robots drive.
    """

    wrong_sighting: Probability = 0.02
    wild_corner: Probability = 1e-4
    disturbed: Probability = 1e-6
    event: Probability = 1e-2
    noise: Probability = 5e-4
    room: tuple[Positive, Positive, Positive] = (30.0, 30.0, 5.0)


class FusionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator."""

    estimator: Literal["smoother", "particle", "ekf"] = "smoother"
    late: Positive = 1.0
    correction_rate: Positive = 10.0
    seed: int = 0
    target_translation: NotNegative = 0.0
    target_rotation: NotNegative = 0.0
    priors: PriorConfig = PriorConfig()


class RecorderConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The recording; sizes in bytes, times in seconds."""

    directory: str = "sessions"
    pictures: bool = False
    keys: tuple[str, ...] = ()
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    synchronise: Positive = 5.0
    split_bytes: NotNegative = 0.0
    split_time: NotNegative = 0.0
    minimum_free: NotNegative = 1e8
    when_full: Literal["stop", "free"] = "stop"
    ring_bytes: Positive = 256e6


class RouterConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The router, where the site has one."""

    picture_rate: Positive | None = None


class PointConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One surveyed point: a camera's optical centre, or a mark on the floor that a robot stood on.

    `position`: x, y and, where it was surveyed, z, metres; or `pixel`: column and row in the plan.
    """

    position: tuple[float, ...] | None = None
    pixel: tuple[float, float] | None = None
    sigma: Positive = 0.01
    robot: str | None = None
    at: NotNegative = 0.0

    def __post_init__(self) -> None:
        if (self.position is None) == (self.pixel is None):
            raise ValueError("a point has either `position` (m) or `pixel` (of the plan); give one")
        if self.position is not None and len(self.position) not in (2, 3):
            raise ValueError(
                f"`position` has {len(self.position)} numbers; write [x, y] or [x, y, z]"
            )
        if not all(math.isfinite(value) for value in (self.position or self.pixel or ())):
            raise ValueError("`position` and `pixel` are finite numbers; correct them")


class MapConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the map lies in the building: by surveyed points, or by its origin alone."""

    frame: str = "building"
    level: bool = True
    origin: tuple[float, float, float] | None = None
    plan: str | None = None
    points: dict[str, PointConfig] = {}

    def __post_init__(self) -> None:
        _check_name("frame", self.frame)
        if self.frame == "map":
            raise ValueError("`map` is the frame that is aligned; call the building's otherwise")
        if self.points and self.origin is not None:
            raise ValueError("`origin` and [map.points] say the same twice; take one of them out")
        if not (self.points or self.plan or self.origin):
            raise ValueError("[map] says nothing; give points, an origin or a plan")
        for name, point in self.points.items():
            if point.pixel is not None and self.plan is None:
                raise ValueError(f"points.{name} is a pixel of no plan; give `plan` too")
            if not self.level and len(point.position or ()) != 3:
                raise ValueError(f"points.{name} has no z, which level = false needs; give it")


class _SiteFile(Struct, frozen=True, forbid_unknown_fields=True):
    site: str
    cameras: dict[str, CameraConfig]
    robots: dict[str, RobotConfig]
    target: str | None = None
    bus: BusConfig = BusConfig()
    fusion: FusionConfig = FusionConfig()
    recorder: RecorderConfig = RecorderConfig()
    router: RouterConfig = RouterConfig()
    map: MapConfig | None = None

    def __post_init__(self) -> None:
        for what, name in [
            ("site", self.site),
            *(("camera", name) for name in self.cameras),
            *(("robot", name) for name in self.robots),
        ]:
            _check_name(what, name)
        if not self.cameras or not self.robots:
            raise ValueError("a site needs at least one camera and one robot; add them")
        for name, robot in self.robots.items():
            if robot.target is None and self.target is None:
                raise ValueError(f'robot «{name}» has no target; write target = "target.toml"')
        for name, point in (self.map.points if self.map else {}).items():
            self._check_point(name, point)

    def _check_point(self, name: str, point: PointConfig) -> None:
        if point.robot is None and name not in self.cameras:
            raise ValueError(
                f"map.points.{name}: there is no camera «{name}»{nearest(name, self.cameras)} "
                "(a mark on the floor says which `robot` stood on it)"
            )
        if point.robot is not None and point.robot not in self.robots:
            raise ValueError(
                f"map.points.{name}: there is no robot «{point.robot}»"
                f"{nearest(point.robot, self.robots)}"
            )
        if point.robot is not None and name in self.cameras:
            raise ValueError(f"map.points.{name} is a camera; a mark needs another name")


class Site(Struct, frozen=True):
    """A whole site. `directory` is the folder that the file's relative paths start from."""

    name: str
    cameras: dict[str, CameraConfig]
    robots: dict[str, RobotConfig]
    bus: BusConfig
    fusion: FusionConfig
    recorder: RecorderConfig
    directory: Path
    text: str
    default_target: str | None = None
    router: RouterConfig = RouterConfig()
    map: MapConfig | None = None

    def camera(self, name: str) -> CameraConfig:
        """A camera by name; raise ConfigError that lists the known ones."""
        return _pick(self.cameras, name, "camera")

    def robot(self, name: str) -> RobotConfig:
        """A robot by name; raise ConfigError that lists the known ones."""
        return _pick(self.robots, name, "robot")

    def target_name(self, robot: str) -> str:
        """The path of a robot's target file as the site file writes it."""
        name = self.robot(robot).target or self.default_target
        assert name is not None  # held by the file's own check
        return name

    def path(self, relative: str) -> Path:
        """A path in the file, made absolute or relative to the working folder."""
        return self.directory / relative

    @property
    def first_robot(self) -> str:
        """The robot whose odometry frame is the map's origin."""
        return next(iter(self.robots))


def endpoint_host(endpoint: str) -> str:
    """The host of a checked endpoint: tcp/localhost:7447 -> localhost."""
    return _endpoint(endpoint)["host"]


def is_loopback(endpoint: str) -> bool:
    """Whether a checked endpoint stays on this machine."""
    host = endpoint_host(endpoint)
    return host in ("localhost", "[::1]") or host.startswith("127.")


def is_secured(endpoint: str) -> bool:
    """Whether certificates are shown on both ends of it."""
    return endpoint.startswith(("tls/", "quic/"))


def endpoint_port(endpoint: str) -> int:
    """The port of a checked endpoint; 0 where the system is to pick one."""
    return int(_endpoint(endpoint)["port"])


def _endpoint(endpoint: str) -> re.Match[str]:
    match = _ENDPOINT.match(endpoint)
    assert match is not None  # held by BusConfig's own check
    return match


def load_site(path: Path) -> Site:
    """Read site.toml; raise ConfigError that names file, line and key."""
    text = read_text(path, "site file", ConfigError)
    return parse_site(text, directory=path.parent, file=str(path))


def parse_site(text: str, *, directory: Path, file: str = "site.toml") -> Site:
    """Like `load_site`, from text (a recording's attachment)."""
    return _site(parse_toml(text, _SiteFile, file, ConfigError), directory, text)


def _site(file: _SiteFile, directory: Path, text: str) -> Site:
    return Site(
        name=file.site,
        cameras=file.cameras,
        robots=file.robots,
        bus=file.bus,
        fusion=file.fusion,
        recorder=file.recorder,
        directory=directory,
        text=text,
        default_target=file.target,
        router=file.router,
        map=file.map,
    )


def check_name(what: str, name: str) -> None:
    """Raise ConfigError where a name cannot be a part of a key and of a ROS topic."""
    try:
        _check_name(what, name)
    except ValueError as reason:
        raise ConfigError(str(reason)) from None


def _check_name(what: str, name: str) -> None:
    if not _NAME.fullmatch(name) or "__" in name:
        raise ValueError(
            f"the {what}'s name «{name}» must match [a-z][a-z0-9_]* without «__»; rename it"
        )


def _pick(items: dict[str, _Item], name: str, kind: str) -> _Item:
    if name not in items:
        known = ", ".join(items)
        raise ConfigError(f"there is no {kind} «{name}» in the site file; it has {known}")
    return items[name]
