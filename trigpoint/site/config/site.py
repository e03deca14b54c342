"""site.toml: one frozen configuration for a whole site; each node reads its own part."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal, TypeVar

from msgspec import Struct

from trigpoint.base.errors import ConfigError, read_text
from trigpoint.base.words import nearest
from trigpoint.site.toml_file import parse_toml

from .bus import BusConfig, RouterConfig
from .camera import CameraConfig
from .fusion import FusionConfig
from .map import MapConfig, PointConfig
from .metrics import MetricsConfig
from .names import validate_name
from .recorder import RecorderConfig
from .robot import OdometryNoise, RobotConfig

_Item = TypeVar("_Item")
Server = Literal["fusion", "recorder"]
"""What a site may need beside its cameras' agents and its robots' bridges."""

# What only one camera can be behind; folders, videos and plug-ins may be opened twice.
_DEVICES = ("v4l2", "rtsp")


class SiteFile(Struct, frozen=True, forbid_unknown_fields=True):
    """The file as it is written: every table below it."""

    site: str
    cameras: dict[str, CameraConfig]
    robots: dict[str, RobotConfig] = {}
    target: str | None = None
    expect: tuple[Server, ...] | None = None
    bus: BusConfig = BusConfig()
    fusion: FusionConfig = FusionConfig()
    metrics: MetricsConfig = MetricsConfig()
    recorder: RecorderConfig = RecorderConfig()
    router: RouterConfig = RouterConfig()
    map: MapConfig | None = None

    def __post_init__(self) -> None:
        for what, name in [
            ("site", self.site),
            *(("camera", name) for name in self.cameras),
            *(("robot", name) for name in self.robots),
        ]:
            validate_name(what, name)
        if not self.cameras:
            raise ValueError("a site needs at least one camera; add it")
        for name, robot in self.robots.items():
            if robot.target is None and self.target is None:
                raise ValueError(f'robot «{name}» has no target; write target = "target.toml"')
        topics = {name: robot.topic for name, robot in self.robots.items() if robot.topic}
        _check_apart("robot", "topic", topics)
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


def _check_apart(kind: str, key: str, places: Mapping[str, str]) -> None:
    """Refuse two of a kind that are at one and the same place, by name."""
    first: dict[str, str] = {}
    for name, place in places.items():
        other = first.setdefault(place, name)
        if other != name:
            raise ValueError(f"{kind}s {other} and {name} have the same `{key}`; give each its own")


class Site(Struct, frozen=True):
    """A whole site. `directory`: the folder to which the file's paths are relative; `expect`: what
    runs beside agents and bridges, None if that is whatever was seen alive."""

    name: str
    cameras: dict[str, CameraConfig]
    robots: dict[str, RobotConfig]
    bus: BusConfig
    fusion: FusionConfig
    recorder: RecorderConfig
    directory: Path
    text: str
    default_target: str | None = None
    expect: tuple[Server, ...] | None = None
    router: RouterConfig = RouterConfig()
    map: MapConfig | None = None
    metrics: MetricsConfig = MetricsConfig()

    def camera(self, name: str) -> CameraConfig:
        """A camera by name; raise a ConfigError that lists the known ones."""
        return _pick(self.cameras, name, "camera")

    def robot(self, name: str) -> RobotConfig:
        """A robot by name; raise a ConfigError that lists the known ones."""
        return _pick(self.robots, name, "robot")

    def check_one_machine(self, *, cameras: Iterable[str], robots: Iterable[str] = ()) -> None:
        """Raise ConfigError if two of these, which are to run on one machine, have one device."""
        sources = {name: self.camera(name) for name in cameras}
        ports = {name: self.robot(name).place for name in robots}
        try:
            _check_apart(
                "camera",
                "source",
                {name: one.place for name, one in sources.items() if one.scheme in _DEVICES},
            )
            _check_apart("robot", "port", {name: port for name, port in ports.items() if port})
        except ValueError as reason:
            raise ConfigError(
                f"the site file: {reason}, or start only what is on this machine"
            ) from None

    def bearable_clock_offset_s(self, camera: str) -> float:
        """How far a camera's clock may be from fusion's: as far as every robot's odometry bears,
        beyond the time offset that is estimated."""
        odometry = [robot.odometry for robot in self.robots.values()] or [OdometryNoise()]
        borne_s = min(noise.bearable_clock_offset_s for noise in odometry)
        return self.camera(camera).most_time_offset_s + borne_s

    def target_name(self, robot: str) -> str:
        """The path of a robot's target file, as written in the site file."""
        name = self.robot(robot).target or self.default_target
        assert name is not None  # guaranteed by the file's check
        return name

    @property
    def target_names(self) -> list[str]:
        """The paths of the target files that cameras look for: every robot's, or the site's own
        where there is no robot yet."""
        if not self.robots and self.default_target is not None:
            return [self.default_target]
        return [self.target_name(robot) for robot in self.robots]

    def path(self, relative: str) -> Path:
        """A path from the file, made absolute or relative to the working folder."""
        return self.directory / relative

    @property
    def first_robot(self) -> str:
        """The robot whose odometry frame is the map's origin; raise ConfigError where the site has
        none, so that nothing can be located."""
        if not self.robots:
            raise ConfigError(
                f"site {self.name} has no robot, and cameras are located by one that drives past "
                "them; add [robots.r1] to the site file (cameras alone: edge, record, view, status)"
            )
        return next(iter(self.robots))


def load_site(path: Path, settings: Mapping[str, object] | None = None) -> Site:
    """Read site.toml; raise a ConfigError that names file, line and key. `settings`: dotted keys,
    like «fusion.seed», to values that stand in place of the file's."""
    remedy = "give --site FILE, or set TRIGPOINT_SITE"
    text = read_text(path, "site file", ConfigError, remedy=remedy)
    return parse_site(text, directory=path.parent, file=str(path), settings=settings)


def parse_site(
    text: str,
    *,
    directory: Path,
    file: str = "site.toml",
    settings: Mapping[str, object] | None = None,
) -> Site:
    """Like `load_site`, from text (a recording's attachment)."""
    return _site(parse_toml(text, SiteFile, file, ConfigError, settings), directory, text)


def _site(file: SiteFile, directory: Path, text: str) -> Site:
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
        expect=file.expect,
        router=file.router,
        map=file.map,
        metrics=file.metrics,
    )


def _pick(items: dict[str, _Item], name: str, kind: str) -> _Item:
    if name not in items:
        known = ", ".join(items) or "none"
        raise ConfigError(f"there is no {kind} «{name}» in the site file; it has {known}")
    return items[name]
