"""Raw pictures of a bag, of any encoding, size and step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.base.errors import MessageError
from trigpoint.recorder.session.bag import RawImage
from trigpoint.tools.pictures.bag import grey_of

ENCODINGS = {
    "mono8": 1,
    "rgb8": 3,
    "RGB8": 3,
    "bgra8": 4,
    "mono16": 2,
    "rgb16": 6,
    "bayer_rggb8": 1,
    "bayer_rggb16": 2,
    "yuyv": 2,
    "nv12": 1,
}


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


@pytest.mark.parametrize("encoding", ["mono8", "nv12", "i420", "mono16", "rgb16", "bgra16"])
def test_raw_picture_keeps_its_brightness(encoding: str) -> None:
    """Of 12 bits in 16 the same; of planes the first."""
    grey = np.arange(16 * 12, dtype=np.uint8).reshape(12, 16)
    wide = encoding.endswith("16")
    samples = np.repeat(grey.astype("<u2") * 16 if wide else grey, ENCODINGS.get(encoding, 1) // 2)
    if encoding in ("nv12", "i420", "mono8"):
        samples = np.append(grey, np.full(0 if encoding == "mono8" else grey.size // 2, 128))
    if encoding == "bgra16":
        samples = np.repeat(grey.astype("<u2") * 16, 4)
    data = np.frombuffer(samples.astype("<u2" if wide else np.uint8).tobytes(), np.uint8)
    image = RawImage(0, encoding, False, 16, 12, data.size // 12 if wide else 16, data)
    assert np.array_equal(grey_of(image), grey.astype(np.uint16) * 16 if wide else grey)


@pytest.mark.parametrize("encoding", ["mono8", "bayer_rggb8", "nv12"])
@pytest.mark.parametrize("times", [1, 3])
@pytest.mark.parametrize("is_in_step", [False, True])
def test_rows_of_another_encoding_are_no_picture(
    encoding: str, times: int, is_in_step: bool
) -> None:
    """Colours called grey would be read as a picture a third as wide; planes that follow are."""
    width, height = 640, 12
    data = np.zeros(times * width * height, np.uint8)
    step = times * width if is_in_step else width
    image = RawImage(0, encoding, False, width, height, step, data)
    if times == 1 or encoding == "nv12":
        assert grey_of(image).shape == (height, width)
        return
    with pytest.raises(MessageError, match=f"3 times 640 × 12 pixels of {encoding}"):
        grey_of(image)


@pytest.mark.parametrize("is_in_step", [False, True])
def test_brightness_and_colour_by_turns_are_not_grey_and_a_half_of_two_pictures_is(
    is_in_step: bool,
) -> None:
    """YUYV called mono8 would be read as stripes."""
    width, height = 640, 12
    across = np.tile(np.arange(width) // 3, (height, 1)).astype(np.uint8)
    yuyv = np.stack([across, np.full_like(across, 128)], axis=-1)
    step = 2 * width if is_in_step else width
    image = RawImage(0, "mono8", False, width, height, step, yuyv.ravel())
    with pytest.raises(MessageError, match="2 times 640 × 12 pixels of mono8"):
        grey_of(image)
    both = np.concatenate([across, across[:, ::-1]], axis=1).ravel()
    left = RawImage(0, "mono8", False, width, height, 2 * width, both)
    assert np.array_equal(grey_of(left), across)
