"""ChArUco boards: OpenCV's corner ids, and which face and robot they are of."""

import cv2
import msgspec
import numpy as np
import pytest
from support.pictures.boards import (
    charuco,
    checkerboard,
    cluttered_picture,
    picture_of,
    placed,
    plain_picture,
    target_of,
    true_pixels,
    worst_error,
)

from trigpoint.base.errors import TargetError
from trigpoint.edge.detector import detector_for
from trigpoint.site.target import Face


def opencv_corners(face: Face, picture: np.ndarray) -> dict[int, np.ndarray]:
    """What OpenCV's own detector finds, by id."""
    ids = np.arange(face.first_marker, face.first_marker + face.marker_count)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, face.dictionary or ""))
    board = cv2.aruco.CharucoBoard(
        (face.columns, face.rows), face.square, face.marker or 0.0, dictionary, ids
    )
    board.setLegacyPattern(face.legacy)
    shown = 255 - picture if face.inverted else picture
    corners, found, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(shown)
    return {
        int(i): pixel for i, pixel in zip(found.reshape(-1), corners.reshape(-1, 2), strict=True)
    }


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 5), (6, 4)])
def test_corner_ids_are_those_of_opencv(
    columns: int, rows: int, legacy: bool, inverted: bool
) -> None:
    board = charuco(columns, rows, first=3, legacy=legacy, inverted=inverted)
    view = placed(board, distance=0.7, turn_deg=10, tilt_deg=20, yaw_deg=-25)
    picture = picture_of([view])
    (face,) = detector_for([target_of(board)]).detect(picture)
    assert face.corners.tolist() == list(range(board.corner_count))
    assert worst_error(face.pixels, face.corners, view) < 0.25
    theirs = opencv_corners(board, picture)
    assert len(theirs) > 6
    for corner, pixel in theirs.items():
        assert np.linalg.norm(face.pixels[corner] - pixel) < 1.0


@pytest.mark.parametrize("turn_deg", [0, 90, 180, 270, 33])
def test_numbers_turn_with_the_board(turn_deg: float) -> None:
    board = charuco()
    view = placed(board, turn_deg=turn_deg, tilt_deg=-15)
    (face,) = detector_for([target_of(board)]).detect(picture_of([view]))
    assert len(face.corners) == board.corner_count
    assert worst_error(face.pixels, face.corners, view) < 0.25


def test_faces_of_one_picture_are_told_apart() -> None:
    faces = [charuco(number=number, first=10 * number) for number in range(3)]
    views = [
        placed(faces[0], distance=1.3, x=-0.4, yaw_deg=35),
        placed(faces[1], distance=1.3, yaw_deg=-35),
        placed(faces[2], distance=1.2, x=0.35, turn_deg=90),
    ]
    found = detector_for([target_of(*faces)]).detect(picture_of(views, noise=2.0))
    assert sorted(face.face for face in found) == [0, 1, 2]
    for face in found:
        assert face.target == "box"
        assert worst_error(face.pixels, face.corners, views[face.face]) < 0.8


def test_hidden_half_leaves_the_others_their_numbers() -> None:
    board = charuco(6, 5)
    view = placed(board, distance=0.8)
    picture = picture_of([view])
    middle = round(true_pixels(view)[:, 0].mean())
    picture[:, :middle] = 90
    (face,) = detector_for([target_of(board)]).detect(picture)
    assert {4, 9, 14, 19} <= set(face.corners.tolist())
    assert {0, 5, 10, 15}.isdisjoint(face.corners.tolist())
    assert worst_error(face.pixels, face.corners, view) < 0.3


def test_board_that_the_picture_cuts_off_is_seen_in_part() -> None:
    board = charuco(6, 5)
    view = placed(board, distance=0.6, x=-0.3)
    (face,) = detector_for([target_of(board)]).detect(picture_of([view]))
    assert 4 <= len(face.corners) < board.corner_count
    assert worst_error(face.pixels, face.corners, view) < 0.3


def test_same_board_on_two_robots_is_found_twice_and_names_no_target() -> None:
    board = charuco()
    views = [placed(board, x=-0.2, distance=0.9), placed(board, x=0.2, y=0.1, distance=1.0)]
    robots = [target_of(board, name="one"), target_of(board, name="two")]
    found = detector_for(robots).detect(picture_of(views))
    assert [(face.target, face.face) for face in found] == [("", 0)] * 2
    left, right = sorted(found, key=lambda face: float(face.pixels[:, 0].mean()))
    assert worst_error(left.pixels, left.corners, views[0]) < 0.4
    assert worst_error(right.pixels, right.corners, views[1]) < 0.4


def test_board_of_other_markers_is_not_ours() -> None:
    picture = picture_of([placed(charuco(first=100))])
    assert detector_for([target_of(charuco())]).detect(picture) == ()


@pytest.mark.parametrize(
    ("printed", "said"),
    [
        ("DICT_5X5_50", "DICT_4X4_50"),
        ("DICT_5X5_1000", "DICT_4X4_50"),
        ("DICT_6X6_250", "DICT_4X4_50"),
        ("DICT_4X4_50", "DICT_5X5_50"),
        ("DICT_ARUCO_ORIGINAL", "DICT_4X4_100"),
    ],
)
def test_markers_of_another_dictionary_are_not_ours_though_some_read_alike(
    printed: str, said: str
) -> None:
    true, ours = (msgspec.structs.replace(charuco(), dictionary=name) for name in (printed, said))
    for seed in range(6):
        view = placed(true, x=0.05 * seed - 0.1, distance=0.5 + 0.1 * seed, tilt_deg=9 * seed - 20)
        assert detector_for([target_of(ours)]).detect(picture_of([view], seed=seed)) == ()


def test_small_markers_are_read_that_opencv_gives_up() -> None:
    board = charuco()
    view = placed(board, distance=1.75, tilt_deg=20, yaw_deg=20)
    picture = picture_of([view], noise=3.0, blur_px=0.9)
    (face,) = detector_for([target_of(board)]).detect(picture)
    assert len(face.corners) > len(opencv_corners_or_none(board, picture))
    assert worst_error(face.pixels, face.corners, view) < 1.5


def opencv_corners_or_none(face: Face, picture: np.ndarray) -> dict[int, np.ndarray]:
    try:
        return opencv_corners(face, picture)
    except (AttributeError, TypeError):  # OpenCV returns None for nothing
        return {}


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_in_clutter(seed: int) -> None:
    faces = [charuco(number=number, first=10 * number) for number in range(6)]
    assert detector_for([target_of(*faces)]).detect(cluttered_picture(seed)) == ()


@pytest.mark.parametrize("noise", [0.0, 4.0, 40.0])
def test_nothing_is_found_in_noise(noise: float) -> None:
    assert detector_for([target_of(charuco())]).detect(plain_picture(noise=noise)) == ()


def test_checkerboard_is_no_charuco_board() -> None:
    picture = picture_of([placed(checkerboard(5, 4), distance=0.4)])
    assert detector_for([target_of(charuco())]).detect(picture) == ()


def test_faces_of_several_patterns_are_found_together() -> None:
    faces = [charuco(), checkerboard(number=1)]
    views = [placed(faces[0], distance=1.0, x=-0.25), placed(faces[1], distance=0.9, x=0.25)]
    found = detector_for([target_of(*faces)]).detect(picture_of(views))
    assert sorted(face.face for face in found) == [0, 1]


def test_unknown_dictionary_is_named_with_the_known_ones() -> None:
    wrong = msgspec.structs.replace(charuco(), dictionary="DICT_9X9_10")
    with pytest.raises(TargetError, match=r"DICT_9X9_10.*DICT_4X4_50"):
        detector_for([target_of(wrong)])


def test_dictionary_with_too_few_markers_is_named() -> None:
    with pytest.raises(TargetError, match=r"DICT_4X4_250 has 250"):
        detector_for([target_of(charuco(first=245))])
