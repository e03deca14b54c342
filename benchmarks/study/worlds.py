"""The worlds of the study: the demo's lab with its noise, driven through in different ways."""

from collections.abc import Callable
from functools import partial

from msgspec import structs

from trigpoint.tools.simulation.world import World
from trigpoint.tools.simulation.world_file import TargetChoice, WorldFile, load_world_file

Place = tuple[float, float]

# Once around: the way to each camera, and a square of waypoints there, left where it was entered.
_STAGES: tuple[tuple[str, tuple[Place, ...], tuple[Place, ...]], ...] = (
    ("c1", (), ((0.4, 2.0), (0.8, 2.0), (0.8, 2.4), (0.4, 2.4))),
    ("c2", ((0.4, 1.3),), ((3.0, 1.3), (3.0, 0.8), (2.5, 0.8), (2.5, 1.3))),
    (
        "c5",
        ((4.4, 1.3), (4.4, 1.95), (5.5, 1.95), (5.5, 1.3)),
        ((7.4, 1.3), (7.4, 0.8), (6.9, 0.8), (6.9, 1.3)),
    ),
    ("c4", ((9.5, 1.3),), ((9.5, 2.15), (9.1, 2.15), (9.1, 1.75), (9.5, 1.75))),
    ("c3", ((9.5, 2.6),), ((6.95, 2.6), (6.95, 3.1), (7.45, 3.1), (7.45, 2.6))),
    (
        "c6",
        ((5.5, 2.6), (5.5, 1.95), (4.4, 1.95), (4.4, 2.6)),
        ((2.5, 2.6), (2.5, 3.1), (3.0, 3.1), (3.0, 2.6)),
    ),
)
_START, _CORNER, _END = (0.4, 2.6), (0.4, 2.6), ((0.4, 2.6), (0.4, 1.3), (2.9, 1.3))
# Through the door and back: no camera looks there.
_DOOR = ((4.4, 1.7), (5.5, 1.7), (5.5, 2.2), (4.4, 2.2))


def around(*, laps: int = 1, circles: int = 0, door_rounds: int = 0) -> WorldFile:
    """The lab, driven around so many times; with `circles` before every camera it is the dance;
    `door_rounds`: how often it circles unseen before it goes to the east room."""
    way: list[Place] = [_START]
    for lap in range(laps):
        way += [_CORNER] if lap else []
        for name, approach, square in _STAGES:
            way += approach
            if name == "c5" and lap == 0 and door_rounds:
                way = [*way[:-3], *(_DOOR * door_rounds), *way[-3:]]
            way += [*(square * circles), square[0]]
    way += _END
    file = load_world_file("lab")
    robot = structs.replace(file.robots["r1"], waypoints=tuple(way), corner_radius=0.25)
    return structs.replace(file, robots={"r1": robot}, hold_first=1.0, hold_last=0.5)


def drive(*, rate_hz: float | None = None) -> WorldFile:
    """The demo's drive, at other picture rates where one is given."""
    return structs.replace(load_world_file("lab"), picture_rate=rate_hz, hold_first=1.0)


def one_picture() -> WorldFile:
    """Once around the lab with a picture or two a camera and pass."""
    return load_world_file("loop")


def two_robots(other: TargetChoice) -> WorldFile:
    """Two robots that drive half of the lab each and never meet; the second one starts before c4
    and carries the `other` target."""
    file = load_world_file("lab")
    first = file.robots["r1"]
    way = first.waypoints
    east = (9.35, 1.6)
    robots = {
        "r1": structs.replace(first, waypoints=(*way[:7], (9.35, 2.2)), target="charuco"),
        "r2": structs.replace(first, waypoints=(east, *way[7:]), target=other),
    }
    return structs.replace(file, robots=robots, hold_first=1.0)


WORLDS: dict[str, Callable[[], WorldFile]] = {
    "drive": drive,
    "drive_10hz": partial(drive, rate_hz=10.0),
    "one_picture": one_picture,
    "dance": partial(around, circles=2),
    "loop": partial(around, laps=3),
    "long_way": partial(around, door_rounds=20),
    "two_laps": partial(around, laps=2),
    "two_robots": partial(two_robots, "checkerboard"),
    "robots_alike": partial(two_robots, "charuco"),
}

# The dance's time, in which the loop is cut off.
LAST_S = {"loop": "dance"}


def world_of(name: str, *, seed: int, target: TargetChoice | None) -> World:
    """A world of the table."""
    world = World(name, WORLDS[name](), seed=seed, target=target)
    if name in LAST_S:
        world.duration_s = World(name, WORLDS[LAST_S[name]](), seed=seed, target=None).duration_s
    return world
