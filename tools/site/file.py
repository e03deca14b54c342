"""Writes site.toml and target.toml from the structs that read them, so they cannot go stale."""

from collections.abc import Iterator

import msgspec
from msgspec import Struct

from trigpoint.site.config import (
    BusConfig,
    CameraConfig,
    FusionConfig,
    MapConfig,
    MavlinkConfig,
    MetricsConfig,
    OdometryNoise,
    PointConfig,
    PriorConfig,
    RecorderConfig,
    RobotConfig,
    RouterConfig,
    SafetyConfig,
    TlsConfig,
    WheelConfig,
)
from trigpoint.site.target import NOWHERE, Face, Pattern, Target
from trigpoint.site.toml_file import toml_value
from trigpoint.tools.shapes.bodies import Side, box_faces
from trigpoint.tools.shapes.text import target_text

COMMENTS: dict[tuple[type[Struct], str], str] = {
    (BusConfig, "connect"): "a router or a peer elsewhere, like tls/192.168.1.10:7447; "
    "quic/… beside it: corrections by datagrams too",
    (BusConfig, "listen"): "what to open to the network; nothing unless it is written here",
    (BusConfig, "scouting"): "true: find peers on the link by multicast",
    (BusConfig, "insecure"): "true: no certificates, on a network of its own",
    (TlsConfig, "directory"): "trust.pem and this machine's keys (trigpoint secure)",
    (RouterConfig, "picture_rate"): "pictures a second of a camera that a router hands on",
    (CameraConfig, "source"): "or rtsp://…, file:///clip.mp4, dir:///pictures",
    (CameraConfig, "width"): "pixels",
    (CameraConfig, "height"): "pixels",
    (CameraConfig, "rate"): "pictures a second that are looked at",
    (CameraConfig, "intrinsics"): "or a camera_info YAML (trigpoint intrinsics), taken as known",
    (CameraConfig, "horizontal_fov"): "degrees; the start where nothing else is known of the lens",
    (CameraConfig, "focal_sigma"): "prior sigmas where estimated: focal length, relative",
    (CameraConfig, "centre_sigma"): "principal point, of the width",
    (CameraConfig, "distortion_sigma"): "each distortion coefficient",
    (
        CameraConfig,
        "time_offset_sigma",
    ): "prior sigma of the time offset, s; estimated above 0 (rtsp: 0.2)",
    (CameraConfig, "time_drift_sigma"): "of the clock's drift, s/s; only with a time offset",
    (CameraConfig, "notice_nudges"): "true: it notices by its own background that it was turned",
    (CameraConfig, "creep_translation"): "m per √day that the mount may creep; 0: it does not",
    (CameraConfig, "creep_rotation"): "rad per √day",
    (CameraConfig, "line_delay"): "of a rolling shutter: s from one row to the next, like 30e-6",
    (CameraConfig, "picture_rate"): "pictures a second that are sent where someone looks",
    (CameraConfig, "picture_quality"): "of their JPEG, 1 to 100",
    (RobotConfig, "port"): "or any URL that pyserial opens",
    (RobotConfig, "baud"): "bits a second",
    (RobotConfig, "protocol"): "or create2, mavlink, ros_arduino_bridge; ros2: no port, on the bus",
    (RobotConfig, "topic"): "of a ros2 robot: its odometry's topic, where that is not ours",
    (RobotConfig, "max_speed"): "m/s; odometry that says more is refused",
    (RobotConfig, "max_turn"): "rad/s; the same of turns",
    (
        WheelConfig,
        "diameter",
    ): "m; for protocols that send encoder counts; 0: as the protocol knows it",
    (WheelConfig, "track"): "m between the wheels' contact points",
    (WheelConfig, "ticks"): "counts a turn of a wheel",
    (WheelConfig, "left_scale"): "the left wheel's diameter by the one above; below 0: reversed",
    (WheelConfig, "right_scale"): "the same of the right wheel",
    (WheelConfig, "bits"): "ros_arduino_bridge: at how many bits its counts wrap, 32 or 16",
    (WheelConfig, "order"): 'which count is of which side, like "lrlr"; -: of none',
    (MavlinkConfig, "system"): "the bridge's system id: the vehicle's own",
    (MavlinkConfig, "component"): "the bridge's component id (197: visual inertial odometry)",
    (MavlinkConfig, "send"): "the message that tells a pose: odometry or vision",
    (MavlinkConfig, "key"): "file with the signing key, 64 hexadecimal digits",
    (RobotConfig, "target"): "this robot's own target file",
    (RobotConfig, "planar"): "false: the odometry's full 3D motion is used (a ramp, an arm)",
    (SafetyConfig, "max_age"): "s; an older correction is not handed on",
    (SafetyConfig, "max_jump"): "m; nor one that moves the robot further",
    (SafetyConfig, "max_turn"): "rad; or turns it further",
    (SafetyConfig, "max_sigma"): "m; nor one that is less certain",
    (SafetyConfig, "max_heading_sigma"): "rad",
    (SafetyConfig, "establish_motion"): "m or rad between corrections that place it anew",
    (SafetyConfig, "blend"): "s over which a step is spread; 0: the robot takes it at once",
    (OdometryNoise, "distance"): "m per √m, along the track",
    (OdometryNoise, "lateral"): "m per √m, across it",
    (OdometryNoise, "heading_drive"): "rad per √m",
    (OdometryNoise, "heading_turn"): "rad per √rad",
    (OdometryNoise, "vertical"): "m per √m, where planar = false",
    (OdometryNoise, "tilt"): "rad per √m, where planar = false",
    (OdometryNoise, "tilt_turn"): "rad per √rad, where planar = false",
    (OdometryNoise, "distance_scale"): "prior sigma of a constant scale error; estimated above 0",
    (OdometryNoise, "heading_scale"): "the same of turns",
    (FusionConfig, "estimator"): "or particle, ekf",
    (FusionConfig, "late"): "s; an older sighting still enters the network, but corrects nobody",
    (FusionConfig, "correction_rate"): "Hz, at most",
    (FusionConfig, "seed"): "of the particle filter",
    (FusionConfig, "learn"): "false: the network is fixed, corrections only",
    (FusionConfig, "target_translation"): "m; prior sigma of each face's pose; estimated above 0",
    (FusionConfig, "target_rotation"): "rad; the same",
    (PriorConfig, "wrong_sighting"): "probability that a sighting does not show its robot",
    (PriorConfig, "wild_corner"): "that a corner of a good sighting is far off",
    (PriorConfig, "disturbed"): "that somebody carries a robot or moves a camera in a session",
    (PriorConfig, "event"): "then, from one visit to the next, that it happens in between",
    (
        PriorConfig,
        "push_translation",
    ): "m; sigma of how far a camera is pushed, if not hung elsewhere",
    (PriorConfig, "push_rotation"): "rad; the same",
    (
        PriorConfig,
        "floor_tilt",
    ): "rad; how much floors slope where pictures do not tell; 0: flat",
    (PriorConfig, "target_sway"): "m; the same of how a target sways on its robot",
    (PriorConfig, "noise"): "that noise is far from what is stated, unless the session tells",
    (PriorConfig, "room"): "m; the box in which cameras hang and robots drive",
    (RecorderConfig, "directory"): "where recordings go",
    (RecorderConfig, "pictures"): "true: pictures are recorded too (then they leave the cameras)",
    (RecorderConfig, "keys"): "only keys that match, like camera/*/sightings; none: all",
    (RecorderConfig, "compression"): "or lz4, none",
    (RecorderConfig, "synchronise"): "s; what a power cut may take",
    (RecorderConfig, "split_bytes"): "a new file at this size; 0: never",
    (RecorderConfig, "split_time"): "s; a new file after this time; 0: never",
    (RecorderConfig, "daily"): "true: a new file with each day, UTC",
    (RecorderConfig, "minimum_free"): "bytes that stay free on the disk",
    (RecorderConfig, "when_full"): "or free: then the oldest finished recording is removed",
    (RecorderConfig, "budget"): "bytes of all recordings, then the oldest go; 0: any number",
    (RecorderConfig, "ring_bytes"): "most that `record --ring` holds in memory",
    (MetricsConfig, "listen"): "where a program here serves Prometheus's /metrics; else --metrics",
    (MetricsConfig, "insecure"): "true: machines elsewhere may read them too",
    (MapConfig, "frame"): "the building's frame, in which points and plan are",
    (MapConfig, "level"): "false: tilt is worked out too, from 3 points not in line",
    (MapConfig, "origin"): "without points: the map's origin in the frame, m, m, rad",
    (MapConfig, "plan"): "a floor plan, as ROS map_server's YAML",
    (PointConfig, "position"): "x, y (and z) in the frame, m",
    (PointConfig, "pixel"): "or column and row in the plan's picture",
    (PointConfig, "sigma"): "m; how well it was surveyed, each axis",
    (PointConfig, "robot"): "not a camera but a mark: which robot stood on it,",
    (PointConfig, "at"): "s after its first odometry",
}

_EXAMPLES = {
    (CameraConfig, "source"): "v4l2:///dev/video0",
    (RobotConfig, "target"): "target.toml",
    (RouterConfig, "picture_rate"): 2.0,
    (WheelConfig, "bits"): 16,
    (RobotConfig, "topic"): "/r1/odom",
    (MavlinkConfig, "key"): "mavlink.key",
    (MetricsConfig, "listen"): "127.0.0.1:9464",
    (MapConfig, "origin"): (0.0, 0.0, 0.0),
    (MapConfig, "plan"): "plan.yaml",
    (PointConfig, "position"): (1.25, 4.5, 2.6),
    (PointConfig, "pixel"): (312.0, 870.5),
    (PointConfig, "robot"): "r1",
}
"""Values of keys without a default; optional keys are written as comments."""

_WRITTEN = {
    (CameraConfig, "intrinsics"): "estimate",
    (CameraConfig, "time_offset_sigma"): 0.0,
    (RobotConfig, "port"): "/dev/ttyUSB0",
}
"""Values that replace defaults unsuitable for a first site: nothing announces a lens that nobody
has measured, and a robot without a port is another kind of robot."""

_TABLES = ("tls",)
"""Optional tables; they are written as comments."""

_COMMENT_COLUMN = 32

_HEAD = """\
# One file for a whole site; each program reads its own part. Paths are relative to this file.
# `trigpoint doctor --site site.toml` says whether it fits this machine.
site = "lab"
target = "target.toml"          # default for every robot
"""

_EXPECT = """\
# expect = ["fusion"]           # and "recorder": what must run; none: what was ever seen alive
"""


_FIRST_KEYS = ("source", "width", "height", "rate", "intrinsics", "horizontal_fov")


def first_site_text(
    *, source: str | None = None, port: str | None = None, protocol: str | None = None
) -> str:
    """The shortest site file: one camera, one robot, this machine alone. What is known of them goes
    in place of the examples; the protocol is written where it is said."""
    said = {
        (CameraConfig, "source"): source,
        (RobotConfig, "port"): port,
        (RobotConfig, "protocol"): protocol,
    }
    values: dict[tuple[type[Struct], str], object] = {
        place: value for place, value in said.items() if value is not None
    }
    of_robot = ("port", "baud", "protocol") if protocol else ("port", "baud")
    tables = [
        _table("cameras.c1", CameraConfig, only=_FIRST_KEYS, values=values),
        _table("robots.r1", RobotConfig, only=of_robot, values=values),
    ]
    return "\n".join([_HEAD, *tables])


def full_site_text() -> str:
    """Every key with its default and a comment."""
    tables = [
        _table("bus", BusConfig),
        _commented(_table("bus.tls", TlsConfig)),
        _table("cameras.c1", CameraConfig),
        _table("robots.r1", RobotConfig),
        _table("robots.r1.wheels", WheelConfig),
        _table("robots.r1.mavlink", MavlinkConfig),
        _table("robots.r1.odometry", OdometryNoise),
        _table("robots.r1.safety", SafetyConfig),
        _table("fusion", FusionConfig),
        _table("fusion.priors", PriorConfig),
        _table("recorder", RecorderConfig),
        _table("router", RouterConfig),
        _table("metrics", MetricsConfig),
        _commented(_table("map", MapConfig)),
        _commented(_table("map.points.c1", PointConfig)),
    ]
    return "\n".join([_HEAD + _EXPECT, *tables])


def _commented(table: str) -> str:
    """An optional table, as comments."""
    return "".join(f"# {line.removeprefix('# ')}\n" for line in table.splitlines() if line)


def _table(
    name: str,
    struct: type[Struct],
    *,
    only: tuple[str, ...] | None = None,
    values: dict[tuple[type[Struct], str], object] | None = None,
) -> str:
    rows = [
        line
        for line in _rows(struct, values or {})
        if only is None or line.lstrip("# ").startswith(only)
    ]
    return "\n".join([f"[{name}]", *rows, ""])


def _rows(struct: type[Struct], values: dict[tuple[type[Struct], str], object]) -> Iterator[str]:
    """A line for each key: `values` go before examples, and those before defaults."""
    for field in msgspec.structs.fields(struct):
        default = field.default
        if isinstance(default, Struct) or field.name in _TABLES or field.default_factory is dict:
            continue  # a table of its own
        place = (struct, field.name)
        value = ({place: default} | _WRITTEN | _EXAMPLES | values)[place]
        sign = "# " if default is None and place in _EXAMPLES else ""
        row = f"{sign}{field.name} = {toml_value(value)}"
        yield f"{row:<{_COMMENT_COLUMN - 2}}  # {COMMENTS[place]}"


_TARGET_HEAD = (
    "Three ChArUco faces on a box: ahead, left and right. For your own box, vanes or single board,",
    "with poses and a PDF: trigpoint target make --help",
    "translation and quaternion are base_from_face: x along a row of corners, y from row to row, z",
    "into the board; the robot's base has x forward, y left, z up. Corner 0 is the top left inner",
    "corner of the face seen upright.",
)
_BOARD = Face(0, Pattern.CHARUCO, 5, 7, 0.035, *NOWHERE, marker=0.026, dictionary="DICT_4X4_100")
_SIDES = (Side.FRONT, Side.LEFT, Side.RIGHT)
_BOX_M, _HEIGHT_M = 0.30, 0.40


def first_target_text() -> str:
    """A target of three faces that fit on A4 and that a picture can tell apart."""
    faces = box_faces(_BOARD, _SIDES, length=_BOX_M, width=_BOX_M, height=_HEIGHT_M)
    return target_text(Target("box", faces), head=_TARGET_HEAD, remarks=dict(enumerate(_SIDES)))
