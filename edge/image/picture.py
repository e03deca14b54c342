"""What a detector takes: a grey or BGR picture of bytes."""

import cv2
import numpy as np

from trigpoint.errors import InputError


def as_grey(picture: np.ndarray) -> np.ndarray:
    """The picture as (height, width) uint8; raise InputError where it is no grey or BGR one."""
    if picture.dtype != np.uint8:
        raise InputError(f"the picture's values are {picture.dtype}; make them 8 bits (uint8)")
    if picture.ndim not in (2, 3) or 0 in picture.shape:
        raise InputError(f"an array of shape {picture.shape} is no picture; give rows × columns")
    if picture.ndim == 2:
        return np.ascontiguousarray(picture)
    if picture.shape[2] == 1:
        return np.ascontiguousarray(picture[..., 0])
    if picture.shape[2] != 3:
        raise InputError(f"the picture has {picture.shape[2]} channels; give grey or BGR")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
