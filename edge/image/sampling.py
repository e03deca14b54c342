"""Values of a picture between its pixels."""

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array


def sampled(image: np.ndarray, pixels: Array) -> Array:
    """Values (…) of an image at pixels (…, 2), interpolated."""
    if pixels.size == 0:
        return np.zeros(pixels.shape[:-1])
    # Remap takes fewer than 2¹⁵ rows and columns, so the first dimension stays rows.
    x, y = np.moveaxis(pixels.astype(np.float32).reshape(len(pixels), -1, 2), -1, 0)
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(pixels.shape[:-1]).astype(float)
