"""What is drawn of a session before its first message: the recipe, by kind and seed."""

import zlib
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace


class Route(StrEnum):
    """How a robot goes about: to every camera once and to two of them again; several times before
    every camera; the same without a stop for a picture; to drawn places along arcs."""

    LOOP = "loop"
    DANCE = "dance"
    DRIVE = "drive"
    FREE = "free"


class Room(StrEnum):
    """Where cameras hang: around an oval, or on the walls of a drawn rectangle."""

    OVAL = "oval"
    WALLS = "walls"


class Recipe(Struct, frozen=True):
    """What happens in a session. Nothing of it unless it is written.

    `route`, `robots`, `is_one_target` (all robots carry the same one), `cameras`, `room`,
    `rate_hz` (None: one picture a stop); `is_alike`: no picture tells the faces apart;
    `pattern`, `shape`: of the target, by the tables in `carried`; `lens`: of those in `room`;
    `smallest_square_px`: that a detector finds.

    Of the sightings: shares of displaced ones, of wild corners, of misnamed faces; `displaced_px`:
    how far, None: drawn each time. Of the site: `time_offset_s`, `scale`, `mount`, `lens_spread`:
    what is unknown and has a prior in the site file. `moves`, `lifts`: how many of each.
    `in_space`: robots also rise, sink and lean. `gaps`: in the odometry. `late_share`,
    `twice_share`: of the sightings' messages.

    `sigma_px`, `noise`: what is told of corners (pixels) and odometry (times the defaults).

    What the site file does not know: `stated`: told over true noise; `tilt_deg`: of the robot at
    each view, or `is_tilt_smooth`: of the floor from place to place; `wobble_m`: of the target;
    `slip`: share of the way lost in bursts; `has_tails`: corners by Student's t with 3 degrees.
    """

    kind: str
    seed: int
    route: Route = Route.LOOP
    robots: int = 1
    is_one_target: bool = True
    cameras: int = 6
    room: Room = Room.OVAL
    rate_hz: float | None = None
    is_alike: bool = False
    pattern: str = "charuco"
    shape: str = "star"
    lens: str = "plain"
    smallest_square_px: float = 7.0
    displaced_share: float = 0.0
    displaced_px: float | None = 15.0
    wild_share: float = 0.0
    misnamed_share: float = 0.0
    time_offset_s: float = 0.0
    scale: float = 0.0
    in_space: bool = False
    mount: bool = False
    lens_spread: bool = False
    moves: int = 0
    lifts: int = 0
    gaps: int = 0
    late_share: float = 0.0
    twice_share: float = 0.0
    sigma_px: float = 0.25
    noise: float = 1.0
    stated: float = 1.0
    tilt_deg: float = 0.0
    is_tilt_smooth: bool = False
    wobble_m: float = 0.0
    slip: float = 0.0
    has_tails: bool = False

    def random(self, purpose: str, *owners: str | int) -> np.random.Generator:
        """The random stream of a purpose: nothing depends on the order of calls."""
        names = [zlib.crc32(str(name).encode()) for name in (self.kind, purpose, *owners)]
        return np.random.default_rng([self.seed, *names])

    @property
    def is_mismatched(self) -> bool:
        """Whether something happens that the site file does not know."""
        unknown = (self.tilt_deg, self.wobble_m, self.slip, self.has_tails)
        return any(unknown) or self.stated != 1.0


def drawn(kind: str, seed: int) -> Recipe:
    """The recipe of a kind and a seed; raise ValueError that lists the kinds."""
    if kind not in KINDS:
        raise ValueError(f"there is no kind «{kind}»; choose of {', '.join(KINDS)}")
    recipe = Recipe(kind, seed)
    preset = KINDS[kind]
    recipe = preset.draw(recipe) if preset.draw else recipe
    recipe = replace(recipe, **preset.always)
    return unknown_to_the_site(recipe) if preset.is_mismatch else recipe


class Preset(Struct, frozen=True):
    """A kind of session: `always` stands above what `draw` drew."""

    title: str
    draw: Callable[[Recipe], Recipe] | None = None
    always: Mapping[str, Any] = field(default_factory=dict)
    is_mismatch: bool = False


def composed(recipe: Recipe) -> Recipe:
    """One robot, two to nine cameras around an oval; each of what may happen by chance."""
    random = recipe.random("recipe")
    route = Route(random.choice(["loop", "dance", "drive"]))
    is_alike = bool(random.random() < 0.4)
    return replace(
        recipe,
        route=route,
        cameras=int(random.integers(2, 10)),
        rate_hz=5.0 if route is Route.DRIVE else None,
        is_alike=is_alike,
        pattern="checkerboard" if is_alike else "charuco",
        displaced_share=float(random.choice([0.0, 0.02, 0.05, 0.1])),
        wild_share=0.02 if random.random() < 0.3 else 0.0,
        time_offset_s=0.05 if route is Route.DRIVE and random.random() < 0.4 else 0.0,
        scale=0.01 if random.random() < 0.35 else 0.0,
        lens_spread=bool(random.random() < 0.2),
        moves=int(random.random() < 0.2),
        lifts=int(random.random() < 0.2),
        sigma_px=float(random.choice([0.1, 0.25, 0.5])),
        noise=float(random.choice([0.5, 1.0, 2.0])),
    )


def everything(recipe: Recipe) -> Recipe:
    """Two to twelve cameras in a drawn room, one to three robots, and all that may happen."""
    recipe = composed(recipe)
    random = recipe.random("recipe of everything")
    route = Route(random.choice(list(Route), p=[0.25, 0.3, 0.25, 0.2]))
    moving = route in (Route.DRIVE, Route.FREE)
    rate_hz = 10.0 if moving or random.random() < 0.2 else None
    alike = ["checkerboard", "checkerboard_odd"]
    known = ["charuco", "charuco_large", "aprilgrid", "checkerboards"]
    robots = int(random.choice([1, 2, 3], p=[0.65, 0.25, 0.1]))
    return replace(
        recipe,
        route=route,
        robots=robots,
        is_one_target=bool(random.random() < 0.5),
        cameras=int(random.integers(2, 13)),
        room=Room(random.choice(list(Room), p=[0.3, 0.7])),
        rate_hz=rate_hz,
        pattern=str(random.choice(alike if recipe.is_alike else known)),
        shape=str(random.choice(["star", "box", "sheet"], p=[0.6, 0.25, 0.15])),
        lens=str(random.choice(["plain", "bent", "fisheye"], p=[0.4, 0.4, 0.2])),
        smallest_square_px=5.0,
        displaced_px=15.0 if random.random() < 0.5 else None,
        misnamed_share=0.02 if not recipe.is_alike and random.random() < 0.2 else 0.0,
        time_offset_s=0.05 if rate_hz and random.random() < 0.35 else 0.0,
        mount=bool(random.random() < 0.15),
        gaps=int(random.choice([0, 1, 2], p=[0.7, 0.2, 0.1])),
        late_share=0.1 if random.random() < 0.25 else 0.0,
        twice_share=0.1 if random.random() < 0.25 else 0.0,
    )


def in_space(recipe: Recipe) -> Recipe:
    """A composition whose robot moves in space; of what is unknown to the site, nothing."""
    return replace(composed(recipe), in_space=True)


def unknown_to_the_site(recipe: Recipe) -> Recipe:
    """The same with things that the site file does not know; at least one of them."""
    random = recipe.random("mismatch")
    hit = random.random(5) < [0.4, 0.4, 0.4, 0.67, 0.3]
    if not hit.any():
        hit[random.integers(5)] = True
    return replace(
        recipe,
        tilt_deg=0.3 if hit[0] else 0.0,
        is_tilt_smooth=bool(random.random() < 0.5),
        wobble_m=0.001 if hit[1] else 0.0,
        slip=float(random.choice([0.02, 0.06])) if hit[2] else 0.0,
        stated=float(random.choice([0.5, 2.0])) if hit[3] else 1.0,
        has_tails=bool(hit[4]),
    )


_ALIKE = {"is_alike": True, "pattern": "checkerboard"}
_DRIVE = {"route": Route.DRIVE, "rate_hz": 5.0}

KINDS: dict[str, Preset] = {
    "everything": Preset("everything at once", everything),
    "everything-mismatch": Preset(
        "everything at once, and what the site file does not know", everything, is_mismatch=True
    ),
    "composition": Preset("one robot, an oval of cameras, each disturbance by chance", composed),
    "mismatch": Preset(
        "a composition with what the site file does not know", composed, is_mismatch=True
    ),
    "space": Preset("a composition with a robot that moves in space", in_space),
    "loop-alike": Preset("a closed loop, one picture a stop, equal checkerboards", always=_ALIKE),
    "dance-alike": Preset("a dance, equal checkerboards", always={"route": Route.DANCE, **_ALIKE}),
    "dance-displaced": Preset(
        "a dance, known faces, 5 % of the sightings off by 15 px",
        always={"route": Route.DANCE, "displaced_share": 0.05},
    ),
    "drive-everything": Preset(
        "a drive, equal checkerboards, time offsets, scales, 3 % displaced",
        always={
            **_DRIVE,
            **_ALIKE,
            "time_offset_s": 0.05,
            "scale": 0.01,
            "displaced_share": 0.03,
        },
    ),
}
