"""Drawn rooms, where no photograph is at hand."""

import cv2
import numpy as np


def room(seed: int) -> np.ndarray:
    """A drawn wall of things, (480, 640) uint8: some large and plain, some small."""
    random = np.random.default_rng(seed)
    picture = np.full((480, 640), 150, np.uint8)
    for _ in range(160):
        x, y, across, down = random.integers([0, 0, 8, 8], [640, 480, 90, 90]).tolist()
        grey = int(random.integers(20, 235))
        cv2.rectangle(picture, (x, y), (x + across, y + down), (grey,), -1)
    return cv2.GaussianBlur(picture, (0, 0), 1.2)
