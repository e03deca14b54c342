"""Raw pictures of a bag, of any encoding, size and step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.base.errors import MessageError
from trigpoint.recorder.session.bag import RawImage
from trigpoint.tools.pictures.bag import grey_of

ENCODINGS = {"mono8": 1, "rgb8": 3, "bgra8": 4, "mono16": 2, "bayer_rggb8": 1, "yuyv": 2}


@given(
    encoding=st.sampled_from([*ENCODINGS, "", "32FC1"]),
    width=st.integers(0, 9).map(lambda half: 2 * half),
    height=st.integers(0, 9).map(lambda half: 2 * half),
    step=st.integers(0, 100),
    size=st.integers(0, 2000),
)
def test_raw_pictures_of_any_step_are_read_or_refused_in_words(
    encoding: str, width: int, height: int, step: int, size: int
) -> None:
    image = RawImage(0, encoding, False, width, height, step, np.zeros(size, np.uint8))
    row = width * ENCODINGS.get(encoding, 1)
    is_whole = any(s >= row and size >= s * (height - 1) + row for s in (step, row))
    if encoding in ENCODINGS and width and height and is_whole:
        assert grey_of(image).shape == (height, width)
    else:
        with pytest.raises(MessageError):
            grey_of(image)
