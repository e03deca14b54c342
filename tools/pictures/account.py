"""What is to be said of a set of pictures: which were left out, and which are deep."""

from collections.abc import Sequence

import numpy as np

from trigpoint.base.errors import InputError, OperationError
from trigpoint.base.words import counted
from trigpoint.edge.image.picture import depth_words

_MOST_NAMED = 5


class PictureAccount:
    """Counts a set's pictures while they are read."""

    def __init__(self) -> None:
        self._read = 0
        self._left_out: dict[str, list[str]] = {}
        self._depths: dict[str, list[str]] = {}

    def add(self, name: str, picture: np.ndarray) -> None:
        """Count a picture that was read, of any depth."""
        self._read += 1
        if words := depth_words(picture):
            self._depths.setdefault(words, []).append(name)

    def leave_out(self, reason: InputError, alike: str = "") -> None:
        """Count a picture that cannot be read; the reason names it. `alike`: what it shares with
        others, of which one says enough."""
        self._left_out.setdefault(alike or str(reason), []).append(str(reason))

    def lines(self) -> list[str]:
        """One for what was left out, one for each depth; raises OperationError where nothing is
        left."""
        count = sum(map(len, self._left_out.values()))
        kinds = [first + _more_alike(more) for first, *more in self._left_out.values()]
        left_out = f"{counted(count, 'picture')} left out: {_some(kinds)}"
        if not self._read:
            why = f"can be read; {left_out}" if self._left_out else "is in what was given"
            raise OperationError(f"no picture {why}")
        depths = [
            f"{counted(len(names), 'picture')} with {words}, and scaled by that: {_some(names)}"
            for words, names in self._depths.items()
        ]
        return [*([left_out] if self._left_out else []), *depths]


def _some(texts: Sequence[str]) -> str:
    more = len(texts) - _MOST_NAMED
    return " | ".join(texts[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _more_alike(more: Sequence[str]) -> str:
    return f" (and {len(more)} more like it)" if more else ""
