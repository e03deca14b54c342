"""The files that fix a simulated world: walls, cameras, lenses, noise, paths; lengths in metres.

Coordinates in a file are those of the floor plan; `world` moves everything into the map.
"""

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct, structs

from trigpoint.base.errors import InputError
from trigpoint.site.config import Count, NotNegative, OdometryNoise, Positive
from trigpoint.site.toml_file import load_toml

TargetChoice = Literal["charuco", "checkerboard"]

WORLDS = Path(__file__).parent / "worlds"
NAMED = {"lab": "lab.toml", "drive": "lab.toml", "loop": "loop.toml", "dance": "dance.toml"}


class WallSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """A line of wall on the floor plan; `points` with the first one repeated close a block."""

    points: tuple[tuple[float, float], ...]
    height: Positive = 2.6
    shade: Annotated[float, Meta(ge=0, le=1)] = 0.7

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise ValueError("a wall needs at least two points; add one")


class CameraSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One camera: where it hangs and looks (degrees), its lens, its time grid and its noise.

    `blur` (of the lens, pixels), `noise` (of a grey value of 255) and `sigma` (of a coordinate in a
    sighting that is simulated without a picture, pixels) are standard deviations; `line_delay` of a
    rolling shutter: seconds from one row to the next.
    """

    position: tuple[float, float, float]
    yaw: float
    pitch: float
    roll: float = 0.0
    width: Count = 640
    height: Count = 480
    horizontal_fov: Annotated[float, Meta(gt=0, lt=180)] = 65.0
    centre_offset: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, ...] = ()
    rate: Positive = 5.0
    phase: NotNegative = 0.0
    exposure: NotNegative = 0.008
    line_delay: float = 0.0
    blur: NotNegative = 0.5
    noise: NotNegative = 2.0
    sigma: Positive = 0.15


class RobotSpec(Struct, frozen=True, forbid_unknown_fields=True):
    """One robot: its path on the floor plan, and how its odometry reports it."""

    waypoints: tuple[tuple[float, float], ...]
    corner_radius: Positive = 0.45
    speed: Positive = 0.4
    acceleration: Positive = 0.4
    odometry_rate: Positive = 50.0
    odometry_start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target: TargetChoice = "charuco"
    odometry: OdometryNoise = OdometryNoise()

    def __post_init__(self) -> None:
        if len(self.waypoints) < 2:
            raise ValueError("a path needs at least two waypoints; add one")


class WorldFile(Struct, frozen=True, forbid_unknown_fields=True):
    """A whole file. `based_on` names a file beside it whose walls, cameras and robots are taken
    where this one has none; `picture_rate` then replaces the cameras' own."""

    site: str | None = None
    based_on: str | None = None
    walls: tuple[WallSpec, ...] = ()
    cameras: dict[str, CameraSpec] = {}
    robots: dict[str, RobotSpec] = {}
    picture_rate: Positive | None = None
    smallest_square: Positive = 7.0
    hold_first: NotNegative = 6.0
    hold_last: NotNegative = 2.0


def load_world_file(name_or_path: str) -> WorldFile:
    """A named world's file or any other; raise InputError that names file, line and key."""
    path = WORLDS / NAMED[name_or_path] if name_or_path in NAMED else Path(name_or_path)
    if path.suffix != ".toml":
        known = ", ".join(NAMED)
        raise InputError(f"there is no world «{name_or_path}»; name {known} or a .toml file")
    file = _with_base(path, load_toml(path, WorldFile, "world file", InputError))
    if not file.cameras or not file.robots or file.site is None:
        raise InputError(f"{path}: a world needs a site, a camera and a robot; add them")
    return file


def _with_base(path: Path, file: WorldFile) -> WorldFile:
    if file.based_on is None:
        return file
    base = load_toml(path.parent / file.based_on, WorldFile, "world file", InputError)
    if base.based_on is not None:
        raise InputError(f"{path}: {file.based_on} is itself based on a file; name that one")
    taken = ("site", "walls", "cameras", "robots", "picture_rate")
    return structs.replace(file, **{n: getattr(file, n) or getattr(base, n) for n in taken})
