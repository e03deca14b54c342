"""Pictures within a page."""

import io

import numpy as np
import pytest
from PIL import Image

from trigpoint.tools.pages.floor_plan import png


@pytest.mark.parametrize("shape", [(5, 7), (4, 3, 4), (1, 1)])
def test_a_pictures_file_shows_it(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    with Image.open(io.BytesIO(png(pixels))) as picture:
        assert picture.format == "PNG"
        assert np.array_equal(np.asarray(picture), pixels)
