"""Dark quadrilaterals, which markers are, whatever dictionary they are from: found by the compiled
core (`native/src/markers`)."""

import numpy as np

from trigpoint.edge.image.region import Region
from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import Handle, In, Kernel, Out

# As of `markers/quads.cpp`: so many pieces are looked at, at the picture's own size and at half of
# it.
MOST_PIECES = 800
_PASSES = 2


class _Search(Handle):
    """Memory for a search, kept for the next picture."""

    name = "tp_quad_search"


_QUADS = Kernel(
    "tp_quads", _Search, In(np.uint8, ("h", "w")), int, int, int, Out(np.float64, ("n", 8))
)


class QuadFinder:
    """Thresholds a picture and looks at the outlines of dark pieces; for one thread.

    `parts_touching`: pieces that touch with their corners are parted, by a pixel of light.
    """

    def __init__(self, *, parts_touching: bool = False) -> None:
        self._search = _Search()
        self._quads = np.empty((_PASSES * MOST_PIECES, 8))
        self.parts_touching = parts_touching

    def find(
        self, grey: np.ndarray, is_over: IsOver = never, within: Region | None = None
    ) -> Array:
        """Corners (n, 4, 2) of the dark quadrilaterals, clockwise from any of the four, pixels;
        `within` a region only those that show at the picture's own size.

        Nothing is looked for where the picture is too crowded.
        """
        if is_over():
            return np.zeros((0, 4, 2))
        region = within or Region.whole(grey)
        part = np.ascontiguousarray(region.of(grey))
        count = _QUADS(
            self._search,
            part,
            max(grey.shape),
            1 if within else _PASSES,
            self.parts_touching,
            self._quads,
        )
        return self._quads[:count].reshape(-1, 4, 2) + region.corner
