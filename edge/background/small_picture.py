"""The small grey picture in which backgrounds are compared."""

import cv2
import numpy as np

WIDTH = 160
"""Pixels across. Through a lens of 60 degrees one of them is 0.4 degrees; a tile's place is known
to a tenth of that, and a comparison takes less than a millisecond."""
_AVERAGED = 4
_COARSE = 13


def small_picture(picture: np.ndarray) -> np.ndarray:
    """A picture (h, w) or (h, w, 3), uint8, as (height, `WIDTH`) float32: grey, less
    the grey about each pixel, so that pools of light and long shadows count little.

    Of large pictures only every so many pixels are averaged: all of them would take longer than the
    rest of a comparison.
    """
    height, width = picture.shape[:2]
    step = max(1, width // (_AVERAGED * WIDTH))
    size = (WIDTH, max(1, round(height * WIDTH / width)))
    small = cv2.resize(picture[::step, ::step], size, interpolation=cv2.INTER_AREA)
    if small.ndim == 3:
        small = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
    small = small.astype(np.float32)
    return small - cv2.blur(small, (_COARSE, _COARSE))
