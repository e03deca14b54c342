"""The page's tables of messages, and the words below that of cameras."""

from html import escape

from trigpoint.tools.networks.truth import MOST_SIGMAS
from trigpoint.tools.pages.frame import table
from trigpoint.tools.pages.svg import element

from .results import Arrival, DemoResults, KindCount

_ARRIVALS = {
    Arrival.COMPLETE: ("complete", None),
    Arrival.BROKEN: ("not complete", "bad-text"),
    Arrival.UNKNOWN: ("a part began anew", "quiet"),
    Arrival.BEST_EFFORT: ("best effort", "quiet"),
}
"""The words for it and their style."""


def camera_words(results: DemoResults) -> str:
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
    return words


def kinds_table(results: DemoResults) -> str:
    """One row a kind of key, the messages of its keys added up."""
    rows = [_counts_row(kind, str(kind.keys)) for kind in results.kinds]
    return table(("key", "keys", "sent", "received", "recorded", ""), rows)


def message_table(results: DemoResults) -> str:
    """One row a key, with who received it."""
    rows = [
        _counts_row(results.counted(count.path, [count]), ", ".join(count.received) or "–")
        for count in results.keys
    ]
    return table(("key", "received by", "sent", "received", "recorded", ""), rows)


def _counts_row(count: KindCount, second: str) -> str:
    cells = (element("code", escape(count.path)), escape(second), *count.numbers)
    words, kind = _ARRIVALS[count.arrival]
    shown = (element("td", cell) for cell in cells)
    return element("tr", *shown, element("td", words, class_=kind))
