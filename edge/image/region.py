"""Parts of a picture, and which of them lie about the faces that are followed."""

from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

# How far about a face others of the same robot are looked for, of the face's longer side.
AROUND_SHARE = 1.0


class Region(Struct, frozen=True):
    """Whole pixels of a picture, from `left` and `top` up to `right` and `bottom`, these not."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def whole(cls, grey: np.ndarray) -> "Region":
        """All of a picture (h, w)."""
        return cls(0, 0, grey.shape[1], grey.shape[0])

    @property
    def corner(self) -> Array:
        """Where it begins, (2,) pixels."""
        return np.array([self.left, self.top], dtype=float)

    def of(self, grey: np.ndarray) -> np.ndarray:
        """That part of a picture (h, w), no copy."""
        return grey[self.top : self.bottom, self.left : self.right]

    def meets(self, other: "Region") -> bool:
        """Whether the two have pixels in common."""
        across = max(self.left, other.left) < min(self.right, other.right)
        return across and max(self.top, other.top) < min(self.bottom, other.bottom)

    def joined(self, other: "Region") -> "Region":
        """The smallest one that holds both."""
        return Region(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )


def regions_around(outlines: Iterable[Array], shape: Sequence[int]) -> list[Region]:
    """Where faces beside others can be: the surroundings of each outline (n, 2) in a picture of
    shape (h, w), pixels; those that meet are one, so that no pixel is searched twice."""
    apart: list[Region] = []
    for outline in outlines:
        region = _around(outline, shape)
        while meeting := [other for other in apart if other.meets(region)]:
            for other in meeting:
                apart.remove(other)
                region = region.joined(other)
        apart.append(region)
    return apart


def _around(outline: Array, shape: Sequence[int]) -> Region:
    reach = AROUND_SHARE * float(np.ptp(outline, axis=0).max())
    limit = np.array(shape[1::-1])
    low = np.clip(np.floor(outline.min(axis=0) - reach), 0, limit).astype(int)
    high = np.clip(np.ceil(outline.max(axis=0) + reach), 0, limit).astype(int)
    return Region(*low.tolist(), *high.tolist())
