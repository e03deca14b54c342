"""The page's first lines: the run in a sentence and in five numbers."""

import math

import numpy as np

from trigpoint.base.words import counted
from trigpoint.tools.pages.frame import centimetres, tile, tiles

from .results import PAPER_DISTANCE_ERROR_M as _PAPER_M
from .results import DemoResults


def headline(results: DemoResults) -> str:
    located, expected = len(results.located), len(results.expected)
    error = results.error.distance
    if located < expected:
        return f"{expected - located} of {expected} cameras could not be located"
    if error is None:
        return f"{located} of {len(results.cameras)} cameras located"
    seen = f"All {located}" if located == len(results.cameras) else f"All {located} visited"
    return f"{seen} cameras located; the distances between them are right to {centimetres(error)}"


def summary(results: DemoResults) -> str:
    return tiles(
        _located(results), _distance(results), _robot(results), _latency(results),
        _messages(results),
    )  # fmt: skip


def _located(results: DemoResults) -> str:
    located, count = len(results.located), len(results.cameras)
    words = "cameras located"
    passed = count - len(results.expected)
    if passed:
        words += f"; the robot did not come by {passed}"
    furthest = max((c.error.sigmas for c in results.located if c.error), default=math.nan)
    if located:
        words += f"; the furthest is {furthest:.1f} of its own sigmas off"
    return tile(f"{located} of {count}", words, is_bad=any(c.is_missed for c in results.cameras))


def _distance(results: DemoResults) -> str:
    error = results.error.distance
    if error is None:
        return ""
    words = f"mean error of the distances between cameras; the paper's is {centimetres(_PAPER_M)}"
    if results.bound_m is not None:
        words += f", and this drive's expected error (Cramér-Rao) {centimetres(results.bound_m)}"
    return tile(centimetres(error), words)


def _robot(results: DemoResults) -> str:
    if not results.robots:
        return ""
    robot = results.robots[0]
    live, odometry = robot.final_error(robot.live), robot.final_error(robot.odometry)
    if live is None or odometry is None:
        return ""
    words = f"off at the drive's end, the robot; {centimetres(odometry.place_m)} by odometry alone"
    return tile(centimetres(live.place_m), words)


def _latency(results: DemoResults) -> str:
    if not len(results.latencies_s):
        return ""
    half, most = 1000 * np.quantile(results.latencies_s, [0.5, 0.95])
    words = f"from exposure to correction, half of the time; 95 % within {most:.0f} ms"
    return tile(f"{half:.0f} ms", words)


def _messages(results: DemoResults) -> str:
    reliable = [count for count in results.keys if count.is_reliable]
    if not reliable:
        return ""
    sent = sum(count.sent or 0 for count in reliable)
    broken = [count for count in reliable if not count.is_complete]
    if results.restarts:
        total = sum(results.restarts.values())
        return tile(f"{total} ×", "a part ended, was started again, and the system went on")
    if broken:
        return tile(
            counted(len(broken), "key"), "on which messages were lost that must arrive", is_bad=True
        )
    return tile("0 lost", f"of {sent} messages on reliable keys: sent, received and recorded")
