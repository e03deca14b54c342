"""Pictures from Python: a target's faces in them, and a camera's lens from them."""

import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import Sightings
from trigpoint.edge.detector import TargetDetector, detector_for
from trigpoint.edge.image.picture import as_grey
from trigpoint.edge.lens.calibration import calibrate
from trigpoint.edge.sources.picture_files import read_picture
from trigpoint.geometry import CameraModel
from trigpoint.geometry.rotation import Array
from trigpoint.site.camera_info import write_camera_info
from trigpoint.site.target import Target, load_target
from trigpoint.tools.pictures.account import PictureAccount
from trigpoint.tools.pictures.detect import Given, check_all, stills
from trigpoint.tools.pictures.intrinsics_search import search

from .networks import PathLike

Pictures = PathLike | np.ndarray | Sequence[PathLike | np.ndarray]
"""A picture (height, width) grey or (height, width, 3) BGR of any depth, or the path of a picture,
a folder of them, a video or a bag; or several of all these."""
_LOG = logging.getLogger(__name__)


class Lens(Struct, frozen=True, eq=False):
    """A camera's intrinsics as pictures say they are.

    `sigma`: of `camera.parameters` (fx, fy, cx, cy, distortion), same order, pixels where those
    are. `doubts`: what the pictures do not determine and what to do, in words; none where the lens
    can be trusted. `rms_px`: of a corner's distance from its prediction. `views`, `rejected`: how
    many views were used and not. `notes`: what was left out, or contradicts the target file.
    """

    camera: CameraModel
    sigma: Array
    doubts: tuple[str, ...]
    rms_px: float
    views: int
    rejected: int
    notes: tuple[str, ...]

    def save(self, path: PathLike) -> None:
        """Write ROS's camera_info YAML, as site files name it."""
        write_camera_info(Path(path), self.camera, Path(path).stem)


def read_target(path: PathLike) -> Target:
    """Read a target file; raises TargetError, an InputError, that names file, line and key."""
    return load_target(Path(path))


def detect(
    picture: PathLike | np.ndarray, target: PathLike | Target, *, stamp_ns: int = 0
) -> Sightings:
    """The target's faces in one picture; `stamp_ns`: when it was taken, middle of exposure.

    `picture`: a file, or (height, width) grey or (height, width, 3) BGR of any depth. What it shows
    that the target file denies is logged as a warning. Raises InputError.
    """
    given = picture if isinstance(picture, np.ndarray) else read_picture(Path(picture))
    detector = detector_for([_target(target)])
    found = _sightings(detector, as_grey(given), stamp_ns)
    _warn(detector.misdescribed)
    return found


def detect_all(
    pictures: Pictures, target: PathLike | Target, *, topic: Sequence[str] = ()
) -> Iterator[tuple[str, Sightings]]:
    """The target's faces in each picture, with its name, in order; `topic`: of bags, those with the
    pictures, by default the only one that has some.

    What cannot be read is left out; that, and what the pictures show that the target file denies,
    is logged as a warning at the end. Raises InputError for paths that are not there,
    OperationError where no picture can be read.
    """
    given, account = _listed(pictures), PictureAccount()
    detector = detector_for([_target(target)])
    check_all(given)
    for still in stills(given, topic, account):
        yield still.name, _sightings(detector, still.picture, 0)
    _warn((*account.lines(), *detector.misdescribed))


def intrinsics(
    pictures: Pictures,
    target: PathLike | Target,
    *,
    topic: Sequence[str] = (),
    jobs: int = 1,
) -> Lens:
    """One camera's intrinsics with sigmas, from pictures of a target held still before it.

    `jobs`: so many processes search (the script then needs `if __name__ == "__main__":`). Raises
    InputError for pictures that are not there or of several sizes, OperationError where they lead
    to no lens at all; what they leave open is in `doubts`.
    """
    given = _listed(pictures)
    check_all(given)
    searched = search(given, [_target(target)], topics=topic, jobs=jobs, is_shown=False)
    found = calibrate(searched.views, searched.size)
    return Lens(
        camera=found.camera,
        sigma=found.known.sigma,
        doubts=tuple(map(str, found.doubts)),
        rms_px=found.fit.rms_px,
        views=len(found.used),
        rejected=len(found.rejected),
        notes=(*searched.account, *searched.misdescribed),
    )


def _sightings(detector: TargetDetector, grey: np.ndarray, stamp_ns: int) -> Sightings:
    height, width = grey.shape
    return Sightings(stamp_ns, "", width, height, detector.detect(grey))


def _target(target: PathLike | Target) -> Target:
    return target if isinstance(target, Target) else read_target(target)


def _listed(pictures: Pictures) -> list[Given]:
    if isinstance(pictures, str | os.PathLike | np.ndarray):
        pictures = [pictures]
    return [one if isinstance(one, np.ndarray) else Path(one) for one in pictures]


def _warn(lines: Sequence[str]) -> None:
    for line in lines:
        _LOG.warning(line)
