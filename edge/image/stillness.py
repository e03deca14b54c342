"""Whether anything changes before a camera that stands still."""

import cv2
import numpy as np

_CHANGED = 6
"""Grey levels, of the mean of 4 × 4 pixels. Squares of five, the smallest that are found, hold some
of these, which differ from what was there by half of a board's contrast at least: by 9 of the
faintest drawn boards that are found. Noise of 3 grey levels changes none so much."""
_SETTLED_NS = 1_000_000_000
"""What has just come to rest is searched for so long: some of that is found in a second picture."""


class Stillness:
    """For one camera's pictures in order."""

    def __init__(self) -> None:
        self._small = np.zeros((0, 0), np.uint8)
        self._since_ns = 0

    def lasts(self, grey: np.ndarray, stamp_ns: int) -> bool:
        """Whether pictures (h, w), uint8, up to this one have been alike for a second."""
        small = _halved(_halved(grey))
        is_like = small.shape == self._small.shape and stamp_ns >= self._since_ns
        if not is_like or cv2.norm(small, self._small, cv2.NORM_INF) > _CHANGED:
            self._small, self._since_ns = small, stamp_ns
        return stamp_ns - self._since_ns >= _SETTLED_NS


def _halved(grey: np.ndarray) -> np.ndarray:
    """At half the size; twice so takes OpenCV an eighth of the time of a quarter at once."""
    height, width = (max(1, length // 2) for length in grey.shape)
    part = grey[: 2 * height, : 2 * width]
    return cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
