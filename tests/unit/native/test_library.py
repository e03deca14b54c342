"""The border to the compiled core: what does not fit is refused before the core sees it."""

import numpy as np
import pytest

from trigpoint.edge.markers.board_ends import ENDS_EARLY
from trigpoint.edge.markers.markers import CELLS
from trigpoint.edge.registration.planar_fit import FIT
from trigpoint.native.library import Handle, In, Kernel, Out

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4)
# Its places are the picture's pixels.
QUADS = np.array([[0.0, 0, 1, 0, 1, 1, 0, 1]])
PLACES = np.array([[0.5, 1.5], [3.0, 2.0], [0.0, 0.0]])


def test_values_between_pixels_are_interpolated() -> None:
    cells = np.zeros((1, 3))
    assert CELLS(GREY, QUADS, PLACES, 0.0, cells) == 1
    seen = np.array([6.5, 11.0, 0.0])
    assert cells[0] == pytest.approx((seen - seen.mean()) / np.linalg.norm(seen - seen.mean()))


def test_values_between_pixels_are_exact() -> None:
    """Dark is 0, light is 6.5: the board's end is seen where less contrast is asked for alone."""
    grey = np.zeros((8, 8), np.uint8)
    grey[::2, 4:], grey[1::2, 4:] = 12, 14
    beside = np.array([[2.0, 2, 2, 5, 3.5, 3.5, 5, 5]])
    places = np.repeat([[5.0, 4], [5, 4], [2, 4]], 6, axis=0).reshape(3, 12)
    fit = np.zeros(FIT)  # which has a face's places at the picture's pixels
    fit[[0, 4, 8, 13]] = 1.0
    looked_at = (places, np.array([0, 0, 1]), np.ones((3, 1), bool))
    seen = [
        ENDS_EARLY(grey, fit, np.array([0]), beside, least, *looked_at)
        for least in (np.nextafter(6.5, 0), 6.5)
    ]
    assert seen == [1, 0]


@pytest.mark.parametrize(
    ("grey", "quads", "cells", "error"),
    [
        (GREY.astype(float), QUADS, np.zeros((1, 3)), TypeError),
        (GREY.tolist(), QUADS, np.zeros((1, 3)), TypeError),
        (GREY[0], QUADS, np.zeros((1, 3)), ValueError),
        (GREY[:, ::2], QUADS, np.zeros((1, 3)), ValueError),
        (GREY, QUADS[:, :7], np.zeros((1, 3)), ValueError),
        (GREY, QUADS, np.zeros((2, 3)), ValueError),
        (GREY, QUADS, np.broadcast_to(0.0, (1, 3)), ValueError),
    ],
)
def test_an_array_of_another_kind_is_refused(
    grey: object, quads: object, cells: object, error: type[Exception]
) -> None:
    with pytest.raises(error, match="tp_cells"):
        CELLS(grey, quads, PLACES, 0.0, cells)


def test_a_missing_argument_is_refused() -> None:
    with pytest.raises(TypeError, match="5 arguments"):
        CELLS(GREY, QUADS)


def test_a_library_of_other_sources_says_what_to_do() -> None:
    with pytest.raises(ImportError, match="make core"):
        Kernel("tp_no_such_function")()


def test_an_object_of_another_kind_is_refused() -> None:
    class Other(Handle):
        name = "tp_pattern"

    class Search(Handle):
        name = "tp_quad_search"

    found = np.empty((4, 8))
    quads = Kernel(
        "tp_quads", Search, In(np.uint8, ("h", "w")), int, int, int, Out(np.float64, ("n", 8))
    )
    with pytest.raises(TypeError, match="tp_quads takes Search, not Other"):
        quads(Other(), np.zeros((8, 8), np.uint8), 4, 800, 2, found)
