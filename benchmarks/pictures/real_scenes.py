"""Real scenes in which no board of ours is: none may be sighted in any of them.

`python -m benchmarks real_scenes` looks for boards of many sizes in the photographs that
scikit-image ships, among them another one's chessboard, at several sizes and turned.
"""

from collections.abc import Iterator

import cv2
import numpy as np
import typer

from trigpoint.edge.detector import detector_for
from trigpoint.site.target import Face, Pattern, Target

from .detection import one_thread
from .empty import APRILGRID
from .photographs import photographs
from .views import gallery

# Small ones are found by chance most easily.
_SIZES = ((4, 3), (5, 4), (7, 4), (8, 5), (9, 7), (10, 7), (18, 8))
_SCALES, _TURNS_DEG = (0.5, 1.0, 2.0), (0.0, 30.0)
_HERE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def scenes() -> Iterator[tuple[str, np.ndarray]]:
    """Every photograph at every size, upright and turned."""
    for name, picture in photographs().items():
        for scale in _SCALES:
            height, width = (max(8, round(scale * side)) for side in picture.shape)
            sized = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            for turn in _TURNS_DEG:
                matrix = cv2.getRotationMatrix2D((width / 2, height / 2), turn, 1.0)
                turned = cv2.warpAffine(
                    sized, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE
                )
                yield f"{name} x {scale:g}, {turn:.0f} degrees", turned


def targets() -> dict[str, Target]:
    """What is looked for, one after the other."""
    boards = {
        f"checkerboard {columns} x {rows}": Target(
            "sheet", (Face(0, Pattern.CHECKERBOARD, columns, rows, 0.03, *_HERE),)
        )
        for columns, rows in _SIZES
    }
    lab = {name: gallery(name).target for name in ("checkerboard", "charuco")}
    return boards | lab | {"aprilgrid": Target("sheet", (APRILGRID,))}


def main() -> None:
    """Count what is sighted where nothing is."""
    with one_thread():
        detectors = {name: detector_for([target]) for name, target in targets().items()}
        wrong, count = dict.fromkeys(detectors, 0), 0
        for scene, picture in scenes():
            count += 1
            for name, detector in detectors.items():
                if found := detector.detect(picture):
                    wrong[name] += len(found)
                    typer.echo(f"{name}: sighted in {scene}")
        for name, number in wrong.items():
            typer.echo(f"{name}: {number} false sightings in {count} scenes")
