"""The border to the compiled core: what does not fit is refused before the core sees it."""

import numpy as np
import pytest

from trigpoint.native.library import Handle, In, Kernel, Out

SAMPLED = Kernel(
    "tp_sampled", In(np.uint8, ("h", "w")), In(np.float64, ("n", 2)), Out(np.float64, ("n",))
)
GREY = np.arange(12, dtype=np.uint8).reshape(3, 4)
PIXELS = np.array([[0.5, 1.5], [3.0, 2.0]])


def test_values_between_pixels_are_interpolated() -> None:
    values = np.zeros(2)
    SAMPLED(GREY, PIXELS, values)
    assert values.tolist() == [6.5, 11.0]


@pytest.mark.parametrize(
    ("grey", "pixels", "values", "error"),
    [
        (GREY.astype(float), PIXELS, np.zeros(2), TypeError),
        (GREY.tolist(), PIXELS, np.zeros(2), TypeError),
        (GREY[0], PIXELS, np.zeros(2), ValueError),
        (GREY[:, ::2], PIXELS, np.zeros(2), ValueError),
        (GREY, PIXELS[:, :1], np.zeros(2), ValueError),
        (GREY, PIXELS, np.zeros(1), ValueError),
        (GREY, PIXELS, np.broadcast_to(0.0, 2), ValueError),
    ],
)
def test_an_array_of_another_kind_is_refused(
    grey: object, pixels: object, values: object, error: type[Exception]
) -> None:
    with pytest.raises(error, match="tp_sampled"):
        SAMPLED(grey, pixels, values)


def test_a_missing_argument_is_refused() -> None:
    with pytest.raises(TypeError, match="3 arguments"):
        SAMPLED(GREY, PIXELS)


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
