"""What a detector takes: a grey picture of bytes, made here of any picture that people have."""

import cv2
import numpy as np

from trigpoint.base.errors import InputError

_GLARING = 1e-3
"""This share of a picture may be brighter than what it is scaled by: hot pixels and glints."""
_MOST_BITS = 64


def as_grey(picture: np.ndarray) -> np.ndarray:
    """The picture as (height, width) uint8; raises InputError like `eight_bits`."""
    plain = eight_bits(picture)
    return plain if plain.ndim == 2 else cv2.cvtColor(plain, cv2.COLOR_BGR2GRAY)


def eight_bits(picture: np.ndarray) -> np.ndarray:
    """Grey (height, width) or BGR (height, width, 3) uint8, of the same with alpha or without and
    of any depth: scaled by the bits that it uses. Raises InputError where it is no picture.

    Sensors of 10, 12 or 14 bits come in words of 16, with their values at either end.
    """
    _check(picture)
    if picture.ndim == 3:
        picture = picture[..., :3] if picture.shape[2] > 2 else picture[..., 0]
    if picture.dtype == np.uint8:
        return np.ascontiguousarray(picture)
    bits = used_bits(picture)
    if picture.dtype.kind != "f":
        return np.clip(picture >> (bits - 8), 0, 255).astype(np.uint8)
    white = 2.0**bits - 1
    shares = np.nan_to_num(picture, nan=0.0, posinf=white, neginf=0.0) / white
    return np.rint(np.clip(shares, 0, 1) * 255).astype(np.uint8)


def used_bits(picture: np.ndarray) -> int:
    """How many bits the values of a picture use, but for a few that glare: 8 or more. 1: fractions
    of white, of which some overshoot. Raises InputError like `eight_bits`."""
    _check(picture)
    if picture.dtype.kind == "f" and _is_below(picture, 2):
        return 1
    return next((n for n in range(8, _MOST_BITS) if _is_below(picture, 1 << n)), _MOST_BITS)


def depth_words(picture: np.ndarray) -> str:
    """What is to be said of a picture's depth, like «12 of 16 bits»; empty where it uses all."""
    bits, all_bits = used_bits(picture), 8 * picture.dtype.itemsize
    if picture.dtype.kind == "f":
        return f"real numbers up to {2**bits - 1}"
    return f"{bits} of {all_bits} bits" if bits < all_bits else ""


def _is_below(picture: np.ndarray, limit: int) -> bool:
    if picture.dtype.kind != "f" and limit > np.iinfo(picture.dtype).max:
        return True
    return int(np.count_nonzero(picture >= limit)) <= _GLARING * picture.size


def _check(picture: np.ndarray) -> None:
    if picture.ndim not in (2, 3) or 0 in picture.shape:
        raise InputError(f"an array of shape {picture.shape} is no picture; give rows × columns")
    if picture.dtype.kind not in "uif":
        raise InputError(f"the picture's values are {picture.dtype}; give whole or real numbers")
    if picture.ndim == 3 and picture.shape[2] > 4:
        raise InputError(f"the picture has {picture.shape[2]} channels; give grey, BGR or BGRA")
