"""Pictures in which no board of ours is: none may be sighted in any of them.

Drawn ones (`empty`) and the photographs that scikit-image ships, among them another one's
chessboard, at several sizes and turned, in which boards of many sizes are looked for.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Annotated

import cv2
import numpy as np
import typer

from benchmarks.compositions.carried import face_of
from benchmarks.table import Row
from benchmarks.timing import worked
from trigpoint.edge.detector import detector_for
from trigpoint.site.target import Pattern, Target

from .empty import empty_pictures
from .real_sets import KALIBR_GRID, photographs
from .views import gallery

# Small ones are found by chance most easily.
_SIZES = ((4, 3), (5, 4), (7, 4), (8, 5), (9, 7), (10, 7), (18, 8))
_row = partial(Row, "false_sightings")
_SCALES, _TURNS_DEG = (0.5, 1.0, 2.0), (0.0, 30.0)


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


def sighted_rows(
    what: str, pictures: Iterable[tuple[str, np.ndarray]], targets: dict[str, Target]
) -> list[Row]:
    """Look for each target in every picture; what is sighted is said at once."""
    detectors = {name: detector_for([target]) for name, target in targets.items()}
    wrong = dict.fromkeys(detectors, 0)
    took_ms: dict[str, list[float]] = {name: [] for name in detectors}
    for scene, picture in pictures:
        for name, detector in detectors.items():
            took, found = worked(lambda d=detector, p=picture: d.detect(p))
            took_ms[name].append(1e3 * took)
            wrong[name] += len(found)
            if found:
                typer.echo(f"{name}: {len(found)} sighted in {scene}", err=True)
    rows = list[Row]()
    for name, took in took_ms.items():
        title = f"{name} in {len(took)} {what}"
        rows += [
            _row(f"{title}, false sightings", "faces", wrong[name], 0.0, "none"),
            _row(f"{title}, a picture at most", "ms", max(took), float(np.mean(took)), "the mean"),
        ]
    return rows


def main(
    count: Annotated[int, typer.Option(help="How many drawn pictures.", min=1)] = 10_000,
    first: Annotated[int, typer.Option(help="The first one's number.", min=0)] = 0,
) -> list[Row]:
    """Look for boards in drawn pictures and photographs that show none."""
    lab = {name: gallery(name).target for name in ("checkerboard", "charuco")}
    lab["aprilgrid"] = Target("sheet", (KALIBR_GRID(0.0715, 0.055),))
    boards = {
        f"checkerboard {columns} x {rows}": Target(
            "sheet", (face_of(Pattern.CHECKERBOARD, columns, rows, 0.03),)
        )
        for columns, rows in _SIZES
    }
    drawn = enumerate(empty_pictures(count, first=first), first)
    found = sighted_rows("drawn", ((f"picture {n}", picture) for n, picture in drawn), lab)
    if find_spec("skimage"):
        return found + sighted_rows("photographs", scenes(), boards | lab)
    typer.echo("photographs: left out; pip install -c constraints.txt -e '.[bench]'", err=True)
    return found
