"""Real pictures: sets with a board each, which are others' and not part of the project; and the
photographs that scikit-image ships (rooms, people, streets, stones, print), there with the extra
`bench`."""

from collections.abc import Iterator
from functools import cache, partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from msgspec import Struct

from benchmarks.compositions.carried import face_of
from trigpoint.edge.image.picture import as_grey
from trigpoint.edge.sources.frames_video import Video
from trigpoint.edge.sources.picture_files import listed_pictures, read_picture
from trigpoint.site.target import Face, Numbering, Pattern


class PictureSet(Struct, frozen=True):
    """Pictures, or videos, of one board in a folder. `every`: one in so many is shown; `times`: so
    many times smaller."""

    name: str
    folder: str
    face: Face
    every: int = 1
    times: int = 1

    def pictures(self, data: Path) -> Iterator[np.ndarray]:
        """Grey ones, (h, w) uint8; none where the folder is not there."""
        folder = data / self.folder
        shown = _all_in(folder) if folder.is_dir() else iter(())
        for picture in islice(shown, None, None, self.every):
            height, width = picture.shape
            size = (width // self.times, height // self.times)
            yield cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def _all_in(folder: Path) -> Iterator[np.ndarray]:
    for file in listed_pictures(folder):
        yield as_grey(read_picture(file))
    for file in sorted(folder.glob("*.mp4")):
        video = Video(file)
        while video.advance() is not None:
            picture = video.picture()
            if picture is not None:
                yield as_grey(picture)
        video.close()


_checkerboard = partial(face_of, Pattern.CHECKERBOARD, square=0.03)
CHARUCO_ARM = face_of(Pattern.CHARUCO, 5, 7, 0.036195, 0.018256, "DICT_6X6_250")
# The marker's share of a square, 0.75, is its authors'; with five rows, legacy makes no difference.
CHARUCO_VIDEO = face_of(Pattern.CHARUCO, 4, 5, 0.054, 0.0405, "DICT_4X4_1000", inverted=True)
KALIBR_GRID = partial(
    face_of, Pattern.APRILGRID, 6, 6, dictionary="DICT_APRILTAG_36h11", border_bits=2
)
APRILGRID = KALIBR_GRID(0.1144, 0.088, numbering=Numbering.KALIBR)
SETS = (
    PictureSet("udacity, 1280 x 720", "boards/udacity", _checkerboard(10, 7)),
    PictureSet("gopro, 1280 x 960", "boards/gopro", _checkerboard(9, 7), every=2),
    PictureSet("camodocal, 1280 x 960", "boards/camodocal", _checkerboard(10, 7), every=3),
    PictureSet("camodocal, 640 x 480", "boards/camodocal", _checkerboard(10, 7), every=3, times=2),
    PictureSet("pjlab, 1920 x 1200", "boards/pjlab", _checkerboard(8, 18), every=2),
    PictureSet("charuco-arm, 1600 x 1200", "charuco-arm", CHARUCO_ARM),
    PictureSet("charuco-video, 1280 x 720", "charuco-video", CHARUCO_VIDEO, every=9),
    PictureSet("aprilgrid, 3072 x 4080", "boards/aprilgrid", APRILGRID),
)
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
