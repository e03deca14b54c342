"""The table that ends a demo, for the terminal. Pure."""

import math
from collections.abc import Iterator

import numpy as np

from trigpoint.base.terminal import table as aligned
from trigpoint.base.words import two_decimals

from .results import PAPER_DISTANCE_ERROR_M, CameraResult, DemoResults, RobotResult

_INDENT = "  "


def table(results: DemoResults) -> str:
    robots = (line for robot in results.robots for line in _robot(robot))
    blocks = _cameras(results), _distances(results), robots, _messages(results), _latency(results)
    return "\n\n".join(text for block in blocks if (text := "\n".join(block)))


def _cameras(results: DemoResults) -> Iterator[str]:
    head = (
        "camera",
        "error cm",
        "sigma cm",
        "error °",
        "sigma °",
        "in sigmas",
        "pictures",
        "missed",
    )
    yield aligned(head, [_camera(camera) for camera in results.cameras])
    for camera in results.cameras:
        for reason in camera.record.undetermined:
            yield f"{_INDENT}{camera.name} is not determined: {reason}"
    if results.overload:
        yield f"{_INDENT}{results.overload}"


def _camera(camera: CameraResult) -> tuple[str, ...]:
    seen = tuple("-" if n is None else str(n) for n in (camera.pictures, camera.skipped))
    if camera.error is None:
        why = camera.record.status if camera.came_by else "not met"
        return camera.name, why, "", "", "", "", *seen
    return (
        camera.name,
        two_decimals(100 * camera.error.position),
        two_decimals(100 * camera.record.position_sigma),
        two_decimals(math.degrees(camera.error.rotation)),
        two_decimals(math.degrees(camera.record.rotation_sigma)),
        f"{camera.error.sigmas:.1f}",
        *seen,
    )


def _distances(results: DemoResults) -> Iterator[str]:
    if results.error.distance is None:
        return
    promised = results.distances.expected_error_m
    yield f"distances between cameras, mean error  {_cm(results.error.distance)}"
    yield f"{_INDENT}the paper's                          {_cm(PAPER_DISTANCE_ERROR_M)}"
    if results.bound_m is not None:
        yield f"{_INDENT}expected at the Cramér–Rao bound     {_cm(results.bound_m)}"
    if promised is not None:
        yield f"{_INDENT}expected by the network's covariance {_cm(promised)}"


def _robot(robot: RobotResult) -> Iterator[str]:
    yield f"robot {robot.name} at the end of its drive, off by"
    for name, track in (
        ("odometry alone", robot.odometry),
        ("as fusion said it live", robot.live),
        ("as the robot itself believes", robot.believed),
        ("by the whole session", robot.smoothed),
    ):
        error = robot.final_error(track)
        if error is not None:
            turn = math.degrees(error.heading_rad)
            yield f"{_INDENT}{name:<36} {_cm(error.place_m)}  {turn:6.2f}°"


def _messages(results: DemoResults) -> Iterator[str]:
    rows = [
        (kind.path, str(kind.keys), *kind.numbers, kind.arrival.value) for kind in results.kinds
    ]
    yield aligned(("messages", "keys", "sent", "received", "recorded", ""), rows, left=(0, 5))


def _latency(results: DemoResults) -> Iterator[str]:
    if len(results.latencies_s):
        half, most = 1000 * np.quantile(results.latencies_s, [0.5, 0.95])
        count = len(results.latencies_s)
        yield f"exposure to correction, {count} of them: p50 {half:.0f} ms, p95 {most:.0f} ms"
    for part, number in results.restarts.items():
        yield f"{part} ended and was started again {number} ×; its counts need not agree"


def _cm(metres: float) -> str:
    return f"{100 * metres:7.2f} cm"
