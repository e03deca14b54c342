"""The table that ends a demo, for the terminal. Pure."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from trigpoint.contract.topics import topic_of

from .results import PAPER_DISTANCE_ERROR_M, CameraResult, DemoResults, KeyCount, RobotResult

_INDENT = "  "


def table(results: DemoResults) -> str:
    """Everything against the truth, as lines."""
    blocks = [
        _cameras(results),
        list(_distances(results)),
        [line for robot in results.robots for line in _robot(robot)],
        _messages(results),
        list(_latency(results)),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _cameras(results: DemoResults) -> list[str]:
    rows = [
        ("camera", "error cm", "sigma cm", "error °", "sigma °", "in sigmas", "pictures", "missed"),
        *(_camera(camera) for camera in results.cameras),
    ]
    lines = aligned(rows)
    for camera in results.cameras:
        lines += [f"{_INDENT}{camera.name} is not determined: {u}" for u in camera.undetermined]
    if results.overload:
        lines.append(f"{_INDENT}{results.overload}")
    return lines


def _camera(camera: CameraResult) -> tuple[str, ...]:
    pictures = "-" if camera.pictures is None else str(camera.pictures)
    skipped = "-" if camera.skipped is None else str(camera.skipped)
    if camera.error is None:
        why = camera.status if camera.came_by else "not met"
        return camera.name, why, "", "", "", "", pictures, skipped
    return (
        camera.name,
        f"{100 * camera.error.position:.2f}",
        f"{100 * camera.sigma_m:.2f}",
        f"{math.degrees(camera.error.rotation):.2f}",
        f"{math.degrees(camera.sigma_rad):.2f}",
        f"{camera.error.sigmas:.1f}",
        pictures,
        skipped,
    )


def _distances(results: DemoResults) -> Iterator[str]:
    if results.mean_distance_error_m is None:
        return
    promised = results.promised_distance_error_m
    yield f"distances between cameras, mean error  {_cm(results.mean_distance_error_m)}"
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


def _messages(results: DemoResults) -> list[str]:
    rows = [
        (*_row(name, counts), results.arrival(counts).value)
        for name, counts in grouped(results.keys).items()
    ]
    return aligned([("messages", "keys", "sent", "received", "recorded", ""), *rows])


def grouped(keys: Sequence[KeyCount]) -> dict[str, list[KeyCount]]:
    """Keys of one row of the contract together, by its path with a `*`."""
    groups: dict[str, list[KeyCount]] = {}
    for count in keys:
        topic = topic_of(f"site/{count.path}")
        name = topic.path.format(id="*") if topic is not None else count.path
        groups.setdefault(name, []).append(count)
    return groups


def _row(name: str, counts: list[KeyCount]) -> tuple[str, ...]:
    sent = [count.sent for count in counts if count.sent is not None]
    received = [min(count.received.values()) for count in counts if count.received]
    return (
        name,
        str(len(counts)),
        str(sum(sent)) if sent else "-",
        str(sum(received)) if received else "-",
        str(sum(count.recorded for count in counts)),
    )


def _latency(results: DemoResults) -> Iterator[str]:
    if len(results.latencies_s):
        half, most = 1000 * np.quantile(results.latencies_s, [0.5, 0.95])
        count = len(results.latencies_s)
        yield f"exposure to correction, {count} of them: p50 {half:.0f} ms, p95 {most:.0f} ms"
    for part, number in results.restarts.items():
        yield f"{part} ended and was started again {number} ×; its counts need not agree"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns under each other: the first and the last to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return lines


def _cm(metres: float) -> str:
    return f"{100 * metres:7.2f} cm"
