"""The charts of a run: the robot's error, the uncertainty, and how long corrections took."""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.tools.pages.axes import Axes
from trigpoint.tools.pages.svg import (
    camera_colour,
    circle,
    element,
    group,
    line,
    polyline,
    text,
    thinned,
)

from .results import PAPER_DISTANCE_ERROR_M, DemoResults, RobotResult, Track

WIDTH, HEIGHT = 520.0, 280.0
_MOST_POINTS = 400
_BARS = 32
_LABEL_HEIGHT = 13.0


def robot_error_chart(results: DemoResults) -> str:
    """Distance between where the robot is and where it is said to be, over time; centimetres."""
    robot = results.robots[0]
    odometry, live = _errors_cm(robot, robot.odometry), _errors_cm(robot, robot.live)
    top = max([1.0, *odometry[1], *live[1]]) * 1.08
    axes = Axes.of(WIDTH, HEIGHT, x=(0.0, results.seconds), y=(0.0, top), right=88.0)
    lines = [
        polyline(thinned(axes.points(*odometry), _MOST_POINTS), class_="way reckoned"),
        polyline(thinned(axes.points(*live), _MOST_POINTS), class_="way corrected"),
    ]
    ends = [
        (float(axes.up(errors[-1])), name, kind)
        for (_, errors), name, kind in (
            (odometry, "odometry", "reckoned-text"),
            (live, "corrected", "corrected-text"),
        )
        if len(errors)
    ]
    label = "The robot's error over time, by odometry alone and corrected"
    return axes.chart("seconds", "robot's error, cm", *lines, _labels(axes, ends), label=label)


def uncertainty_chart(results: DemoResults) -> str:
    """Every camera's standard deviation over time, centimetres, on a logarithmic scale."""
    every = np.concatenate([[0.1, 10.0], *(100 * s.sigma_m for s in results.series)])
    every = every[every > 0]
    bounds = 10 ** np.floor(np.log10(every.min())), 10 ** np.ceil(np.log10(every.max()))
    axes = Axes.of(
        WIDTH, HEIGHT, x=(0.0, results.seconds), y=bounds, is_logarithmic=True, right=44.0
    )
    names = [camera.name for camera in results.cameras]
    lines, ends = [], []
    for series in results.series:
        kind = camera_colour(names.index(series.name))
        points = axes.points(series.t_s, 100 * series.sigma_m)
        lines.append(group(polyline(thinned(points, _MOST_POINTS), class_="series"), class_=kind))
        ends.append((float(points[-1, 1]), series.name, f"series-text {kind}"))
    title = "standard deviation of the place, cm"
    label = "The cameras' uncertainty over time"
    return axes.chart("seconds", title, *lines, _labels(axes, ends), label=label)


def latency_chart(results: DemoResults) -> str:
    """How long from the exposure to the correction; milliseconds."""
    milliseconds = 1000 * results.latencies_s
    top = _round_up(float(np.quantile(milliseconds, 0.99)) * 1.15)
    counts, edges = np.histogram(np.minimum(milliseconds, top), bins=_BARS, range=(0.0, top))
    axes = Axes.of(WIDTH, HEIGHT, x=(0.0, top), y=(0.0, counts.max() * 1.15))
    marks = [
        _mark(axes, float(np.quantile(milliseconds, share)), name, row)
        for row, (share, name) in enumerate(((0.5, "half"), (0.95, "95 %")))
    ]
    return axes.chart(
        "milliseconds from exposure to correction",
        "corrections",
        *axes.bars(counts, edges),
        *marks,
        label="Histogram of the time from exposure to correction",
    )


def distance_chart(results: DemoResults) -> str:
    """Every pair's distance: estimated minus true, with its sigma; centimetres."""
    found, errors_m = results.distances, results.distance_errors_m
    reach = float(np.max(np.maximum(np.abs(errors_m), found.sigmas_m) + found.sigmas_m))
    top = 115 * max(reach, PAPER_DISTANCE_ERROR_M)
    axes = Axes.of(WIDTH, HEIGHT, x=(-0.6, len(errors_m) - 0.4), y=(-top, top))
    paper = 100 * PAPER_DISTANCE_ERROR_M
    low, high = float(axes.up(-paper)), float(axes.up(paper))
    left, right = axes.across.start, axes.across.end
    band = element(
        "rect", x=left, y=high, width=right - left, height=low - high, class_="paper-band"
    )
    zero = line(left, float(axes.up(0)), right, float(axes.up(0)), class_="axis")
    marks = [
        _pair(axes, place, names, 100 * error_m, 100 * sigma_m)
        for place, (names, error_m, sigma_m) in enumerate(
            zip(found.pairs, errors_m.tolist(), found.sigmas_m.tolist(), strict=True)
        )
    ]
    label = "The error of the distance between every two cameras"
    title = "estimated minus true, cm; shaded: the paper's mean error"
    return axes.chart("", title, band, zero, *marks, label=label, names=found.pairs)


def _pair(axes: Axes, place: int, names: tuple[str, str], error_cm: float, sigma_cm: float) -> str:
    x = float(axes.across(place))
    low, middle, high = axes.up([error_cm - sigma_cm, error_cm, error_cm + sigma_cm]).tolist()
    title = element("title", f"{names[0]} to {names[1]}: {error_cm:+.2f} cm")
    return group(title, line(x, low, x, high, class_="whisker"), circle(x, middle, 4, class_="dot"))


def _errors_cm(robot: RobotResult, track: Track) -> tuple[Array, Array]:
    """(seconds, centimetres)."""
    if not len(track.t_s):
        return np.zeros(0), np.zeros(0)
    true = robot.truth.at(track.t_s)
    return track.t_s, 100 * np.linalg.norm(track.places - true.places, axis=1)


def _labels(axes: Axes, ends: list[tuple[float, str, str]]) -> str:
    """Names at the lines' ends, moved apart where they would lie on each other."""
    x, last = axes.across.end + 6, -np.inf
    marks = []
    room = axes.up.start - _LABEL_HEIGHT * (len(ends) - 1)
    for i, (y, name, kind) in enumerate(sorted(ends)):
        last = max(min(y, room + i * _LABEL_HEIGHT), last + _LABEL_HEIGHT)
        marks.append(text(x, last + 4, name, class_=f"label {kind}"))
    return group(*marks)


def _mark(axes: Axes, value: float, name: str, row: int) -> str:
    """A line at a value, from its words on: it crosses none of the rows above."""
    x, top = float(axes.across(value)), axes.up.end + 15 * row
    words = text(x + 5, top + 10, f"{name}: {value:.0f} ms", class_="label mark-text")
    return line(x, top, x, axes.up.start, class_="mark") + words


def _round_up(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * next(n for n in (1, 1.5, 2, 3, 5, 7.5, 10) if n * power >= value))
