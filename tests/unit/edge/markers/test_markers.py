"""Reading markers: which, in which turn, and putting them together to boards."""

import cv2
import numpy as np
import pytest
from support.pictures.boards import charuco

from trigpoint.edge.markers.marker_groups import group_markers
from trigpoint.edge.markers.markers import MarkerReader, Markers
from trigpoint.edge.markers.quads import mapped, square_to_quads
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


def test_corners_of_the_square_go_to_those_of_the_quadrilateral() -> None:
    quads = np.random.default_rng(0).normal(0, 0.1, (5, 4, 2)) + QUAD / 100
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    assert mapped(square_to_quads(quads), square) == pytest.approx(quads)


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
