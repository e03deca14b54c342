"""What is drawn is what is found: faces rasterised from their rectangles, then detected."""

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.edge.detector import detector_for
from trigpoint.edge.registration.dictionaries import predefined_dictionary
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import NOWHERE, Face, Numbering, Pattern, Target
from trigpoint.tools.target.pattern import black_rectangles

PIXELS_PER_METRE = 1600.0
MARGIN_PX = 60


def face(pattern: Pattern, columns: int, rows: int, square: float, **more: object) -> Face:
    return Face(0, pattern, columns, rows, square, *NOWHERE, **more)  # pyright: ignore[reportArgumentType] - the keys are the test's own


FACES = {
    "checkerboard": face(Pattern.CHECKERBOARD, 9, 6, 0.03),
    "charuco": face(Pattern.CHARUCO, 6, 4, 0.05, marker=0.0375, dictionary="DICT_5X5_250"),
    "first_marker": face(
        Pattern.CHARUCO, 5, 5, 0.05, marker=0.04, dictionary="DICT_4X4_100", first_marker=30
    ),
    "legacy": face(
        Pattern.CHARUCO, 5, 6, 0.05, marker=0.04, dictionary="DICT_4X4_100", legacy=True
    ),
    "inverted": face(
        Pattern.CHARUCO, 6, 5, 0.05, marker=0.036, dictionary="DICT_4X4_50", inverted=True
    ),
    "aprilgrid": face(
        Pattern.APRILGRID, 4, 3, 0.07, marker=0.055, dictionary="DICT_APRILTAG_36h11"
    ),
    "kalibr": face(
        Pattern.APRILGRID,
        4,
        3,
        0.07,
        marker=0.055,
        dictionary="DICT_APRILTAG_36h11",
        border_bits=2,
        numbering=Numbering.KALIBR,
    ),
    "corner squares": face(
        Pattern.APRILGRID,
        3,
        4,
        0.07,
        marker=0.055,
        dictionary="DICT_APRILTAG_36h11",
        corner_squares=True,
    ),
    "kalibr with upright tags and nothing between": face(
        Pattern.APRILGRID,
        4,
        3,
        0.07,
        marker=0.055,
        dictionary="DICT_APRILTAG_36h11",
        border_bits=2,
        numbering=Numbering.KALIBR,
        corner_squares=False,
        tags_turned=False,
    ),
}


def rasterised(face: Face, scale: float = PIXELS_PER_METRE) -> np.ndarray:
    """The printed sheet; the outline's low corner lies at the corner of pixel MARGIN_PX."""
    low, high = face.outline.min(axis=0)[:2], face.outline.max(axis=0)[:2]
    width, height = np.ceil((high - low) * scale).astype(int) + 2 * MARGIN_PX
    sheet = np.full((height * 4, width * 4), 255, np.uint8)
    for x, y, w, h in black_rectangles(face):
        first = np.rint(((np.array([x, y]) - low) * scale + MARGIN_PX) * 4).astype(int)
        last = np.rint(((np.array([x + w, y + h]) - low) * scale + MARGIN_PX) * 4).astype(int)
        sheet[first[1] : last[1], first[0] : last[0]] = 0
    small = cv2.resize(sheet, (int(width), int(height)), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (3, 3), 0.7)


def expected(face: Face) -> Array:
    """Where the corners are in the raster, (n, 2), pixels."""
    low = face.outline.min(axis=0)[:2]
    return (face.corners[:, :2] - low) * PIXELS_PER_METRE + MARGIN_PX - 0.5


@pytest.mark.parametrize("name", list(FACES))
def test_every_corner_of_a_drawn_face_is_found_where_the_target_has_it(name: str) -> None:
    face = FACES[name]
    [sighting] = detector_for([Target("t", (face,))]).detect(rasterised(face))
    assert len(sighting.corners) == face.corner_count
    found, places = sighting.pixels, expected(face)[sighting.corners]
    np.testing.assert_allclose(found, places, atol=0.25)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("squares", [False, True])
def test_what_a_kalibr_grid_has_between_its_tags_and_their_way_up_are_seen(
    turned: bool, squares: bool
) -> None:
    known = FACES["kalibr"]
    printed = replace(known, corner_squares=squares, tags_turned=turned)
    [sighting] = detector_for([Target("t", (known,))]).detect(rasterised(printed))
    assert len(sighting.corners) == known.corner_count
    np.testing.assert_allclose(sighting.pixels, expected(printed)[sighting.corners], atol=0.02)


def test_charuco_is_the_board_that_opencv_prints() -> None:
    face = FACES["charuco"]
    dictionary = predefined_dictionary("DICT_5X5_250")
    board = cv2.aruco.CharucoBoard((6, 4), 0.05, 0.0375, dictionary)
    theirs = board.generateImage((6 * 112, 4 * 112))
    ours = np.full(theirs.shape, 255, np.uint8)
    for x, y, w, h in np.rint(
        (black_rectangles(face) + np.array([0.05, 0.05, 0, 0])) * 112 / 0.05
    ).astype(int):
        ours[y : y + h, x : x + w] = 0
    assert np.mean(ours == theirs) > 0.99


def test_rectangles_lie_beside_each_other_and_within_the_outline() -> None:
    for face in FACES.values():
        low, high = face.outline.min(axis=0)[:2], face.outline.max(axis=0)[:2]
        rectangles = black_rectangles(face)
        assert np.all(rectangles[:, :2] >= low - 1e-9)
        assert np.all(rectangles[:, :2] + rectangles[:, 2:] <= high + 1e-9)
        painted = np.zeros(((high - low) * 4000).astype(int)[::-1] + 1, int)
        for x, y, w, h in rectangles:
            x0, y0 = np.rint((np.array([x, y]) - low) * 4000).astype(int)
            x1, y1 = np.rint((np.array([x + w, y + h]) - low) * 4000).astype(int)
            painted[y0:y1, x0:x1] += 1
        assert painted.max() == 1
