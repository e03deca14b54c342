"""Reading markers: which, in which turn, and putting them together to boards."""

import cv2
import numpy as np
import pytest
from support.pictures.boards import charuco

from trigpoint.edge.markers.marker_groups import MOST_GROUPS, group_markers
from trigpoint.edge.markers.markers import MarkerReader, Markers
from trigpoint.edge.registration.printed_pattern import charuco_layout

FACE = charuco(first=20)
QUAD = np.array([[49.5, 49.5], [109.5, 49.5], [109.5, 109.5], [49.5, 109.5]])


def picture(marker: int) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    shown = np.full((160, 160), 220, np.uint8)
    shown[50:110, 50:110] = cv2.aruco.generateImageMarker(dictionary, marker, 60)
    return shown


def read(shown: np.ndarray, quads: np.ndarray) -> Markers:
    reader = MarkerReader("DICT_4X4_250", 1, range(20, 30))
    return reader.best(FACE, reader.scores(shown, quads), quads, least=0.5)


@pytest.mark.parametrize("first", range(4))
def test_marker_is_read_from_whichever_corner_it_starts(first: int) -> None:
    markers = read(picture(23), np.roll(QUAD, first, axis=0)[None])
    assert markers.numbers.tolist() == [3]
    assert markers.scores[0] > 0.95
    assert np.array_equal(markers.corners[0], QUAD)


def test_quadrilateral_without_contrast_is_no_marker() -> None:
    assert len(read(np.full((160, 160), 90, np.uint8), QUAD[None])) == 0


def test_marker_of_another_board_scores_low() -> None:
    markers = read(picture(40), QUAD[None])
    assert len(markers) == 0 or markers.scores[0] < 0.8


def test_slanted_marker_is_read_where_its_cells_are() -> None:
    slanted = np.array([[30.0, 20.0], [130.0, 40.0], [110.0, 120.0], [45.0, 140.0]])
    turn = cv2.getPerspectiveTransform(QUAD.astype(np.float32), slanted.astype(np.float32))
    shown = cv2.warpPerspective(picture(23), turn, (160, 160), borderValue=(220,))
    markers = read(shown, slanted[None])
    assert markers.numbers.tolist() == [3]
    assert markers.scores[0] > 0.95


@pytest.mark.parametrize("where", [np.nan, np.inf, 1e300, 1e5])
def test_quadrilateral_that_is_nowhere_is_no_marker(where: float) -> None:
    assert len(read(picture(23), np.full((1, 4, 2), where))) == 0


def seen_at(offset: np.ndarray, numbers: list[int], scores: list[float], first: int) -> Markers:
    corners = charuco_layout(FACE)[numbers] * 800 + offset
    quads = np.arange(first, first + len(numbers))
    return Markers(np.array(numbers), corners, np.array(scores), quads)


def joined(*parts: Markers) -> Markers:
    order = np.argsort(-np.concatenate([part.scores for part in parts]))
    return Markers(
        np.concatenate([part.numbers for part in parts])[order],
        np.concatenate([part.corners for part in parts])[order],
        np.concatenate([part.scores for part in parts])[order],
        np.concatenate([part.quads for part in parts])[order],
    )


def test_markers_that_agree_are_one_board_and_a_stray_is_left_out() -> None:
    board = seen_at(np.array([300.0, 200.0]), [0, 1, 2, 4], [0.9, 0.7, 0.6, 0.5], 0)
    stray = seen_at(np.array([20.0, 400.0]), [3], [0.7], 9)
    (group,) = group_markers(joined(board, stray), charuco_layout(FACE))
    assert sorted(group.numbers.tolist()) == [0, 1, 2, 4]
    assert 9 not in group.quads


def test_board_in_two_places_is_two_groups() -> None:
    left = seen_at(np.array([100.0, 200.0]), [0, 1, 2], [0.9, 0.8, 0.7], 0)
    right = seen_at(np.array([450.0, 200.0]), [0, 1, 5], [0.85, 0.8, 0.7], 5)
    groups = group_markers(joined(left, right), charuco_layout(FACE))
    assert sorted(sorted(group.quads.tolist()) for group in groups) == [[0, 1, 2], [5, 6, 7]]


def test_number_that_the_face_does_not_have_is_refused() -> None:
    other = Markers(np.array([99]), QUAD[None], np.array([0.9]), np.array([0]))
    with pytest.raises(RuntimeError, match="no marker of that number"):
        group_markers(other, charuco_layout(FACE))


def test_more_boards_than_are_looked_for_are_left() -> None:
    places = [np.array([300.0 * column, 300.0 * row]) for row in range(3) for column in range(4)]
    boards = [seen_at(at, [0, 1, 2], [0.9, 0.8, 0.7], 3 * n) for n, at in enumerate(places)]
    assert len(group_markers(joined(*boards), charuco_layout(FACE))) == MOST_GROUPS


@pytest.mark.parametrize(("strays", "boards"), [(63, 1), (64, 0)])
def test_so_many_markers_are_tried_as_the_start_of_a_board(strays: int, boards: int) -> None:
    """However many a picture shows, most of which are no board's."""
    parts = [seen_at(np.array([1e4 * k, 0.0]), [0], [0.79], k) for k in range(1, strays + 1)]
    board = seen_at(np.zeros(2), [2, 3, 4, 5, 6], [0.75] * 5, 100)
    assert len(group_markers(joined(*parts, board), charuco_layout(FACE))) == boards
