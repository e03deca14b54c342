"""Dance against loop in equal time, the open question of the paper: what the bound says of both."""

from pathlib import Path

import msgspec

from trigpoint.tools.simulation.disturbance import Disturbance
from trigpoint.tools.simulation.in_memory import simulated
from trigpoint.tools.simulation.world import World

from .oracle import bound_of
from .session import plain_inputs
from .store import sources
from .worlds import around

MOST_CIRCLES = 5
_SEED = 0


class Point(msgspec.Struct, frozen=True):
    """After `seconds`: the expected mean error of the distances between cameras, metres."""

    seconds: float
    dance: float
    loop: float


class _Kept(msgspec.Struct, frozen=True):
    sources: str
    points: list[Point]


def kept_equal_times(folder: Path) -> list[Point]:
    """`equal_times`, kept in a folder for as long as the sources are the same."""
    path = folder / "equal_times.json"
    if path.exists():
        kept = msgspec.json.decode(path.read_bytes(), type=_Kept)
        if kept.sources == sources():
            return kept.points
    points = equal_times()
    folder.mkdir(parents=True, exist_ok=True)
    path.write_bytes(msgspec.json.encode(_Kept(sources(), points)))
    return points


def equal_times() -> list[Point]:
    """Once around with 0, 1, 2, … circles before every camera, and going around for as long."""
    points = []
    for circles in range(MOST_CIRCLES + 1):
        dance = World("dance", around(circles=circles), seed=_SEED, target=None)
        loops = World("loop", around(laps=MOST_CIRCLES), seed=_SEED, target=None)
        loops.duration_s = dance.duration_s
        points.append(Point(dance.duration_s, _bound(dance), _bound(loops)))
    return points


def _bound(world: World) -> float:
    session = simulated(world, Disturbance())
    return bound_of(plain_inputs(world), session).mean_distance_error
