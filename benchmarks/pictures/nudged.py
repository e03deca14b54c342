"""How soon a camera notices that it was nudged, how often wrongly, and at what cost.

`python -m benchmarks nudged` draws what cameras see, with real pictures as rooms: those
that scikit-image ships, and with `--pictures` those of a folder. First nudges of several kinds in
traffic and changing light, then hours in which nothing is touched.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from benchmarks.table import Row
from benchmarks.timing import worked
from trigpoint.edge.background.watch import BackgroundWatch, View

from .real_sets import photographs
from .still_hours import StillHour
from .still_scene import Stand, StillScene

NUDGES = {
    "turned by 0.3°": Stand(pan=0.21, tilt=0.21),
    "turned by 0.5°": Stand(pan=0.35, tilt=-0.35),
    "turned by 1°": Stand(pan=-1.0),
    "turned by 5°": Stand(pan=4.0, tilt=3.0),
    "rolled by 1°": Stand(roll=1.0),
    "shifted by 2 cm": Stand(shift_m=0.02),
}
_ROOMS = ("coffee", "motorcycle_left", "rocket", "astronaut", "camera", "brick")
_LOOKS = ("astronaut", "camera", "chelsea", "coins", "grass", "page", "motorcycle_right", "cell")
_BEFORE_S, _AFTER_S, _IN_TIME_S = 45, 30, 3.0
_PICTURES_HZ = 10
_row = partial(Row, "nudged")


def rooms(folder: Path | None, most: int = 12) -> dict[str, np.ndarray]:
    """Grey pictures by name."""
    found = {name: photographs()[name] for name in _ROOMS}
    files = sorted(folder.rglob("*.jpg")) if folder is not None else []
    for file in files[:: max(1, len(files) // most)][:most]:
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if picture is not None:
            found[f"{file.parent.name}/{file.stem}"] = picture
    return found


def delay_of(hour: StillHour, stand: Stand, random: np.random.Generator) -> tuple[float, bool]:
    """After how many seconds a nudge in an hour's traffic is noticed, infinity: not in half a
    minute; and whether the background was seen right before it."""
    watch = BackgroundWatch()
    for second, picture in enumerate(hour.pictures(_BEFORE_S)):
        watch.look(picture, second * 10**9)
    was_seen = watch.is_established and watch.view is View.STILL
    start_ns = round((_BEFORE_S + random.random()) * 1e9)
    for number, picture in enumerate(hour.pictures(_AFTER_S, hz=_PICTURES_HZ, stand=stand)):
        if watch.look(picture, start_ns + number * 10**9 // _PICTURES_HZ):
            return number / _PICTURES_HZ, was_seen
        if number > 4 * _IN_TIME_S * _PICTURES_HZ and not was_seen:
            break
    return np.inf, was_seen


def nudges(worlds: dict[str, np.ndarray], looks: list[np.ndarray], count: int) -> Iterator[Row]:
    """Of each kind of nudge how many are noticed, how soon, and how many that night or people
    hide."""
    for number, (kind, stand) in enumerate(NUDGES.items()):
        seen, hidden = list[float](), list[float]()
        for trial in range(count):
            random = np.random.default_rng([number, trial])
            world = list(worlds.values())[trial % len(worlds)]
            hour = StillHour(StillScene(world, random), looks, random)
            delay_s, was_seen = delay_of(hour, stand, random)
            (seen if was_seen else hidden).append(delay_s)
        delays = np.array(seen or [np.inf])
        noticed = partial(_row, more_is_better=True)
        against = f"of {len(seen)} with the background in sight"
        for limit_s, goal in ((_IN_TIME_S, 99.0), (float(_AFTER_S), 100.0)):
            share = 100 * float(np.mean(delays <= limit_s))
            yield noticed(f"{kind}, noticed within {limit_s:.0f} s", "%", share, goal, against)
        yield _row(f"{kind}, noticed after, median", "s", np.median(delays), _IN_TIME_S, against)
        late = sum(delay < np.inf for delay in hidden)
        yield noticed(f"{kind}, noticed within 12 s", "nudges", late, len(hidden), "all hidden")


def hours(
    worlds: dict[str, np.ndarray], looks: list[np.ndarray], count: int, seconds: int
) -> Iterator[Row]:
    """Of each drawn hour in which nothing is touched, and of all of them."""
    alarms, seen_s, worst = 0, 0, 0.0
    for hour in range(count):
        random = np.random.default_rng([99, hour])
        name = list(worlds)[hour % len(worlds)]
        watch, highest, views = BackgroundWatch(), 0.0, dict.fromkeys(View, 0)
        scene = StillScene(worlds[name], random)
        for second, picture in enumerate(StillHour(scene, looks, random).pictures(seconds)):
            watch.look(picture, second * 10**9)
            views[watch.view] += 1
            if watch.is_established:
                highest = max(highest, watch.suspicion)
        alarms, seen_s = alarms + watch.count, seen_s + views[View.STILL]
        worst = max(worst, highest)
        shares = ", ".join(f"{view} {number / seconds:.0%}" for view, number in views.items())
        yield _row(f"hour {hour}, {name}: {shares}; suspicion", "1", highest, 1.0, "an alarm's")
    drawn, seen = count * seconds / 3600, seen_s / 3600
    yield _row("false alarms", "1", alarms, 0.0, f"of {drawn:.1f} h, {seen:.1f} in sight")
    yield _row("suspicion, the most", "1", worst, 1.0, "an alarm's")


def cost(world: np.ndarray) -> Iterator[Row]:
    """What a comparison at 640 × 480 takes, the best of many, and the reference's memory."""
    random = np.random.default_rng(5)
    scene, watch = StillScene(world, random, width=640, height=480), BackgroundWatch()
    pictures = [scene.picture() for _ in range(200)]
    took_ms = [
        1e3 * worked(lambda p=picture, s=second: watch.look(p, s * 10**9))[0]
        for second, picture in enumerate(pictures)
    ]
    median = float(np.median(took_ms))
    yield _row("a comparison, at best", "ms", min(took_ms[1:]), median, "the median")
    yield _row("the reference", "kB", watch.size_bytes / 1e3, 640 * 480 / 1e3, "a picture")


def main(
    pictures: Annotated[Path | None, typer.Option(help="A folder of rooms, jpg.")] = None,
    count: Annotated[int, typer.Option(help="Nudges of each kind.")] = 60,
    hour: Annotated[int, typer.Option(help="Drawn hours.")] = 12,
    seconds: Annotated[int, typer.Option(help="Of each hour.")] = 3600,
) -> list[Row]:
    """Nudge cameras, and leave them alone."""
    worlds = rooms(pictures)
    looks = [photographs()[name] for name in _LOOKS]
    return [
        *cost(worlds["coffee"]),
        *nudges(worlds, looks, count),
        *hours(worlds, looks, hour, seconds),
    ]
