"""Reading markers: which, in which turn, and putting them together to boards."""

import cv2
import numpy as np
import pytest
from support.pictures.boards import charuco

from trigpoint.edge.markers.marker_groups import MOST_GROUPS, MarkerGroup, group_markers
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
    return MarkerReader.likeliest(reader.scores(shown, quads), quads, 0.5)


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


Seen = tuple[np.ndarray, np.ndarray]
"""Quadrilaterals (n, 4, 2), and their scores (n, markers, 4)."""


def seen_at(offset: np.ndarray, numbers: list[int], scores: list[float]) -> Seen:
    """Markers of a board that lies there, read in the first turn."""
    read = np.zeros((len(numbers), FACE.marker_count, 4))
    read[np.arange(len(numbers)), numbers, 0] = scores
    return charuco_layout(FACE)[numbers] * 800 + offset, read


def grouped(*parts: Seen) -> list[MarkerGroup]:
    quads, scores = (np.concatenate(each) for each in zip(*parts, strict=True))
    return group_markers(quads, scores, 0, charuco_layout(FACE))


def test_markers_that_agree_are_one_board_and_a_stray_is_left_out() -> None:
    board = seen_at(np.array([300.0, 200.0]), [0, 1, 2, 4], [0.9, 0.7, 0.6, 0.5])
    stray = seen_at(np.array([20.0, 400.0]), [3], [0.7])
    (group,) = grouped(stray, board)
    assert sorted(group.numbers.tolist()) == [0, 1, 2, 4]
    assert sorted(group.quads.tolist()) == [1, 2, 3, 4]
    assert group.weight == pytest.approx(2.7)


def test_members_are_given_from_their_own_top_left_on() -> None:
    quads, scores = seen_at(np.zeros(2), [0, 1, 2], [0.9, 0.8, 0.7])
    (group,) = grouped((np.roll(quads, 1, axis=1), np.roll(scores, 1, axis=2)))
    assert np.array_equal(group.corners, quads[group.quads])


def test_board_in_two_places_is_two_groups() -> None:
    left = seen_at(np.array([100.0, 200.0]), [0, 1, 2], [0.9, 0.8, 0.7])
    right = seen_at(np.array([450.0, 200.0]), [0, 1, 5], [0.85, 0.8, 0.7])
    groups = grouped(right, left)
    assert [sorted(group.quads.tolist()) for group in groups] == [[3, 4, 5], [0, 1, 2]]


def test_fewer_markers_than_are_asked_for_are_no_board() -> None:
    quads, scores = seen_at(np.zeros(2), [0, 1, 2], [0.9, 0.8, 0.7])
    found = [
        len(group_markers(quads, scores, 0, charuco_layout(FACE), fewest=fewest))
        for fewest in (3, 4)
    ]
    assert found == [1, 0]


@pytest.mark.parametrize("first", [-1, 1])
def test_markers_that_were_not_scored_are_refused(first: int) -> None:
    quads, scores = seen_at(np.zeros(2), [0], [0.9])
    with pytest.raises(RuntimeError, match="other markers than were scored"):
        group_markers(quads, scores, first, charuco_layout(FACE))


def test_more_boards_than_are_looked_for_are_left() -> None:
    places = [np.array([300.0 * column, 300.0 * row]) for row in range(3) for column in range(4)]
    boards = [seen_at(at, [0, 1, 2], [0.9, 0.8, 0.7]) for at in places]
    assert len(grouped(*boards)) == MOST_GROUPS


@pytest.mark.parametrize(("strays", "boards"), [(63, 1), (64, 0)])
def test_so_many_markers_are_tried_as_the_start_of_a_board(strays: int, boards: int) -> None:
    """However many a picture shows, most of which are no board's."""
    parts = [seen_at(np.array([1e4 * k, 0.0]), [0], [0.79]) for k in range(1, strays + 1)]
    board = seen_at(np.zeros(2), [2, 3, 4, 5, 6], [0.75] * 5)
    assert len(grouped(*parts, board)) == boards
