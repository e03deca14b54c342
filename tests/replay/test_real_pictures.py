"""Real pictures and videos of ChArUco boards, beside OpenCV's own detector."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import REAL_DATA
from support.pictures.boards import target_of

from benchmarks.pictures.real_sets import APRILGRID, CHARUCO_ARM, CHARUCO_VIDEO
from trigpoint.edge.detector import TargetDetector, detector_for
from trigpoint.edge.sources.frames_video import Video
from trigpoint.edge.sources.picture_files import pictures_in, read_picture
from trigpoint.site.target import Face

ARM, VIDEO = REAL_DATA / "charuco-arm", REAL_DATA / "charuco-video"
SCREEN = REAL_DATA / "boards" / "aprilgrid"


def theirs(face: Face, picture: np.ndarray) -> dict[int, np.ndarray]:
    """What OpenCV finds: pixels by corner id."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, face.dictionary or ""))
    size = (face.columns, face.rows)
    board = cv2.aruco.CharucoBoard(size, face.square, face.marker or 0.0, dictionary)
    shown = 255 - picture if face.inverted else picture
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(shown)
    if ids is None:
        return {}
    return {int(i): pixel for i, pixel in zip(ids.reshape(-1), corners.reshape(-1, 2), strict=True)}


def ours(detector: TargetDetector, picture: np.ndarray) -> dict[int, np.ndarray]:
    found = detector.detect(picture)
    assert len(found) <= 1
    return {
        int(i): pixel for face in found for i, pixel in zip(face.corners, face.pixels, strict=True)
    }


def distances(one: dict[int, np.ndarray], other: dict[int, np.ndarray]) -> list[float]:
    return [float(np.linalg.norm(one[i] - other[i])) for i in one.keys() & other.keys()]


@pytest.mark.skipif(not ARM.is_dir(), reason=f"the real pictures of {ARM.name} are not here")
def test_every_corner_of_the_arms_board_is_found_where_opencv_sees_it() -> None:
    detector = detector_for([target_of(CHARUCO_ARM)])
    off = []
    for file in pictures_in(ARM):
        picture = read_picture(file)
        mine, reference = ours(detector, picture), theirs(CHARUCO_ARM, picture)
        assert len(mine) == 24, file.name
        assert len(mine) >= len(reference)
        off += distances(mine, reference)
    assert len(off) > 200
    assert np.percentile(off, 95) < 0.2


@pytest.mark.skipif(not VIDEO.is_dir(), reason=f"the real videos of {VIDEO.name} are not here")
@pytest.mark.parametrize("camera", range(4))
def test_every_picture_of_a_video_gives_as_many_corners_as_opencv_finds(camera: int) -> None:
    detector = detector_for([target_of(CHARUCO_VIDEO)])
    counts, off = [], []
    for picture in every_sixth(VIDEO / f"cam_{camera}.mp4"):
        mine, reference = ours(detector, picture), theirs(CHARUCO_VIDEO, picture)
        counts.append((len(mine), len(reference)))
        off += distances(mine, reference)
        # OpenCV gives lone corners too, of a board that hardly is in the picture.
        assert len(mine) >= len(reference) or len(reference) < 2
    found, reference_found = np.sum(counts, axis=0)
    assert found >= reference_found > 50
    assert np.median(off) < 0.2


def every_sixth(file: Path) -> list[np.ndarray]:
    """Grey pictures 0, 6, 12 … of a video."""
    video, pictures, number = Video(file), [], 0
    while video.advance() is not None:
        picture = video.picture() if number % 6 == 0 else None
        if picture is not None:
            pictures.append(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
        number += 1
    video.close()
    return pictures


@pytest.mark.skipif(not SCREEN.exists(), reason="the shared pictures are not there")
@pytest.mark.parametrize("name", ["000.jpg", "001.jpg", "002.jpg"])
def test_kalibrs_grid_on_a_screen_is_found_whole_and_each_corner_where_opencv_has_its_tags(
    name: str,
) -> None:
    picture = read_picture(SCREEN / name)
    found = ours(detector_for([target_of(APRILGRID)]), picture)
    assert len(found) == APRILGRID.corner_count
    # At a quarter of the size, as at the whole one OpenCV takes twelve seconds.
    small = cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tags, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(small)
    assert ids is not None
    for tag, corners in zip(ids.reshape(-1).tolist(), tags, strict=True):
        for corner, pixel in enumerate(np.asarray(corners).reshape(4, 2) * 4 + 1.5):
            # Kalibr's tags stand on their heads by OpenCV's dictionary.
            own = found[4 * int(tag) + (corner + 2) % 4]
            assert np.linalg.norm(own - pixel) < 20.0  # a seventh of a tag
