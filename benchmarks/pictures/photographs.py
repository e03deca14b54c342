"""Photographs that scikit-image ships: rooms, people, streets, stones, print.

They are there with the extra `bench`.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

# A board of eight by eight squares, and drawings.
_BOARDS = ("chessboard_GRAY", "chessboard_RGB")
_DRAWN = ("logo", "phantom", "horse", "color")


@cache
def photographs() -> dict[str, np.ndarray]:
    """Grey pictures (h, w) uint8 by name; raises ModuleNotFoundError without the extra."""
    spec = find_spec("skimage")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("pip install -c constraints.txt -e '.[bench]'")
    files = sorted((Path(spec.origin).parent / "data").glob("*.[pj][np]g"))
    read = {file.stem: cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files}
    return {name: picture for name, picture in read.items() if picture is not None}


def backgrounds() -> list[np.ndarray]:
    """Those that may lie behind a board of ours."""
    left_out = (*_BOARDS, *_DRAWN)
    return [picture for name, picture in photographs().items() if name not in left_out]
