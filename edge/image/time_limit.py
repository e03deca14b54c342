"""How a search learns that its time is over."""

from collections.abc import Callable

IsOver = Callable[[], bool]
"""Whether the time for a picture is used up."""


def never() -> bool:
    """Of a search that may take its time; its work is bounded by counts."""
    return False
