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
        self._left_out: list[str] = []
        self._depths: dict[str, list[str]] = {}

    def add(self, name: str, picture: np.ndarray) -> None:
        """Count a picture that was read, of any depth."""
        self._read += 1
        if words := depth_words(picture):
            self._depths.setdefault(words, []).append(name)

    def leave_out(self, reason: InputError) -> None:
        """Count a picture that cannot be read; the reason names it."""
        self._left_out.append(str(reason))

    def lines(self) -> list[str]:
        """One for what was left out, one for each depth; raises OperationError where nothing is
        left."""
        left_out = f"{counted(len(self._left_out), 'picture')} left out: {_some(self._left_out)}"
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
