"""The page's tables."""

import math
from html import escape

from trigpoint.tools.report.drawing.style import PALETTE
from trigpoint.tools.report.drawing.svg import element

from .lines import grouped
from .results import (
    MOST_SIGMAS,
    Arrival,
    CameraResult,
    DemoResults,
    KeyCount,
)

_CAMERA_HEAD = (
    "camera", "error<br>cm", "sigma<br>cm", "error<br>degrees", "sigma<br>degrees",
    "error in<br>sigmas", "pictures<br>used", "put<br>aside", "pictures<br>missed",
)  # fmt: skip
_ARRIVALS = {
    Arrival.COMPLETE: ("complete", None),
    Arrival.BROKEN: ("not complete", "bad-text"),
    Arrival.UNKNOWN: ("a part began anew", "quiet"),
    Arrival.BEST_EFFORT: ("best effort", "quiet"),
}
"""The words for it and their style."""


def camera_table(results: DemoResults) -> str:
    """One row a camera."""
    rows = [_camera_row(camera, index) for index, camera in enumerate(results.cameras)]
    return _table(_CAMERA_HEAD, rows)


def _camera_row(camera: CameraResult, index: int) -> str:
    name = f'<span class="disc"></span>{escape(camera.name)}'
    cells = [element("td", name)]
    if camera.error is None:
        why = "; ".join((camera.status, *camera.undetermined))
        cells.append(element("td", escape(why), colspan=5, class_="words"))
    else:
        numbers = (
            f"{100 * camera.error.position:.2f}",
            f"{100 * camera.sigma_m:.2f}",
            f"{math.degrees(camera.error.rotation):.2f}",
            f"{math.degrees(camera.sigma_rad):.2f}",
        )
        cells += [element("td", number) for number in numbers]
        kind = "bad-text" if camera.error.sigmas > MOST_SIGMAS else None
        cells.append(element("td", f"{camera.error.sigmas:.1f}", class_=kind))
    skipped = "–" if camera.skipped is None else str(camera.skipped)
    cells += [element("td", number) for number in (str(camera.sightings), str(camera.rejected))]
    cells.append(element("td", skipped))
    return element("tr", *cells, class_=f"k{index % PALETTE}")


def missing_words(results: DemoResults) -> str:
    """What the columns mean, and why a camera may have no numbers."""
    words = (
        "Sigma is the root of the trace of the camera's covariance. «Error in sigmas» weighs the "
        f"place's error with the full covariance (Mahalanobis); more than {MOST_SIGMAS:.0f} would "
        "be a failure. «Pictures missed» were made but not looked at, since the machine was busy."
    )
    unvisited = [camera.name for camera in results.cameras if not camera.came_by]
    if unvisited:
        words += f" The robot did not come by {', '.join(unvisited)} in this time."
    if results.overload:
        words += f" {results.overload.capitalize()}."
    return escape(words)


def kinds_table(results: DemoResults) -> str:
    """One row a kind of key, the messages of its keys added up."""
    rows = [
        _counts_row(results, name, counts, f"{len(counts)}")
        for name, counts in grouped(results.keys).items()
    ]
    return _table(("key", "keys", "sent", "received", "recorded", ""), rows)


def message_table(results: DemoResults) -> str:
    """One row a key, with who received it."""
    rows = [
        _counts_row(results, count.path, [count], ", ".join(count.received) or "–")
        for count in results.keys
    ]
    return _table(("key", "received by", "sent", "received", "recorded", ""), rows)


def _table(head: tuple[str, ...], rows: list[str]) -> str:
    cells = element("tr", *(element("th", cell) for cell in head))
    return element("table", element("thead", cells), element("tbody", *rows))


def _counts_row(results: DemoResults, name: str, counts: list[KeyCount], second: str) -> str:
    sent = [count.sent for count in counts if count.sent is not None]
    received = [min(count.received.values()) for count in counts if count.received]
    cells = [
        element("td", element("code", escape(name))),
        element("td", escape(second)),
        element("td", str(sum(sent)) if sent else "–"),
        element("td", str(sum(received)) if received else "–"),
        element("td", str(sum(count.recorded for count in counts))),
    ]
    words, kind = _ARRIVALS[results.arrival(counts)]
    return element("tr", *cells, element("td", words, class_=kind))
