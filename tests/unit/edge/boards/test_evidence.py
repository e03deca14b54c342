"""Checkerboards of which a part is hidden: what is seen keeps its numbers, or nothing is said."""

import cv2
import numpy as np
import pytest
from support.pictures.boards import checkerboard, picture_of, placed, target_of, true_pixels

from trigpoint.edge.boards.evidence import weighed
from trigpoint.edge.detector import detector_for
from trigpoint.edge.registration.plane_fitting import fit_plane

FACE = checkerboard(8, 7, number=1)
TRULY_RMS_PX = 0.06


@pytest.mark.parametrize("grey", [30, 120, 220])
@pytest.mark.parametrize("size", [0.2, 0.3])
def test_thing_before_a_board_hides_corners_and_misleads_about_none(size: float, grey: int) -> None:
    view = placed(FACE, tilt_deg=20, yaw_deg=-15)
    pixels = true_pixels(view)
    picture = picture_of([view])
    middle, reach = pixels.mean(axis=0), size * np.ptp(pixels, axis=0).min()
    cv2.circle(picture, middle.astype(int).tolist(), int(reach), (grey,), -1, cv2.LINE_AA)
    (found,) = detector_for([target_of(FACE)]).detect(picture)
    ids = found.corners.astype(int)
    off = found.pixels - pixels[ids]
    hidden = np.linalg.norm(pixels - middle, axis=1) < reach
    assert not hidden[ids].any()
    assert len(ids) >= 0.6 * FACE.corner_count
    assert np.sqrt(np.mean(off**2)) < TRULY_RMS_PX


def test_part_of_a_larger_board_has_no_end_and_is_not_taken() -> None:
    for other, is_ours in ((FACE, True), (checkerboard(9, 7, number=2), False)):
        view = placed(other, tilt_deg=20)
        places = np.arange(other.corner_count).reshape(other.rows - 1, other.columns - 1)
        pixels = true_pixels(view)[places[:, : FACE.columns - 1].reshape(-1)]
        fit = fit_plane(FACE.corners[:, :2], pixels, (640, 480), has_lens=False)
        assert fit is not None
        ids = np.delete(np.arange(FACE.corner_count), [9, 10, 16, 17])
        assert weighed(picture_of([view]), FACE, fit, ids, pixels[ids]).is_board == is_ours


def test_crossing_bars_are_no_board_though_dark_and_light_take_turns() -> None:
    """Of a grille seen from aside, whose openings are wider than its bars: where bars lie midway
    between crossings is an X, and these lie in two kinds of lines that are not evenly apart."""
    view = placed(FACE, tilt_deg=20)
    pixels = true_pixels(view)
    fit = fit_plane(FACE.corners[:, :2], pixels, (640, 480), has_lens=False)
    assert fit is not None
    every = np.arange(FACE.corner_count)
    columns, rows = every % (FACE.columns - 1), every // (FACE.columns - 1)
    side = np.linalg.norm(pixels[1] - pixels[0])
    uneven = pixels + 0.06 * side * np.where((columns + rows) % 2, 1.0, -1.0)[:, None]
    picture = picture_of([view])
    assert weighed(picture, FACE, fit, every, pixels).is_board
    assert not weighed(picture, FACE, fit, every, uneven).is_board


def test_board_without_one_of_its_outermost_lines_is_not_taken() -> None:
    """Which line it is that a hand hides, cannot be seen."""
    view = placed(FACE, tilt_deg=20)
    pixels = true_pixels(view)
    picture = picture_of([view])
    cv2.rectangle(picture, (0, 0), (639, int(pixels[0, 1] + 5)), (60,), -1)
    assert detector_for([target_of(FACE)]).detect(picture) == ()


def test_board_whose_last_line_is_outside_of_the_picture_keeps_its_numbers() -> None:
    view = placed(FACE, tilt_deg=20)
    pixels = true_pixels(view)
    end = int(pixels[FACE.columns - 2 :: FACE.columns - 1, 0].min()) - 3
    cut = np.ascontiguousarray(picture_of([view])[:, :end])
    (found,) = detector_for([target_of(FACE)]).detect(cut)
    assert len(found.corners) == FACE.corner_count - (FACE.rows - 1)
    assert np.abs(found.pixels - pixels[found.corners.astype(int)]).max() < 0.3


@pytest.mark.parametrize("strip", [0.15, 0.3, 0.6])
def test_larger_board_that_leaves_the_picture_is_not_taken_for_ours(strip: float) -> None:
    """Of the next line of its squares that much is in the picture, and no corner."""
    other = checkerboard(9, 7, number=2)
    view = placed(other, tilt_deg=0)
    pixels = true_pixels(view)
    side = (np.ptp(pixels[:, 0]) + 1) / (other.columns - 2)
    end = round(pixels[:, 0].max() + strip * side)
    cut = picture_of([view])[:, :end]
    assert not detector_for([target_of(FACE)]).detect(np.ascontiguousarray(cut))
    assert detector_for([target_of(other)]).detect(picture_of([view]))


@pytest.mark.parametrize(("columns", "rows"), [(8, 6), (6, 7)])
def test_smaller_board_is_not_taken_for_ours(columns: int, rows: int) -> None:
    """Not even where ours would reach beyond the picture: it ends before that."""
    other = checkerboard(columns, rows, number=2)
    view = placed(other, tilt_deg=10)
    pixels = true_pixels(view)
    side = (np.ptp(pixels[:, 0]) + 1) / (columns - 2)
    end = round(pixels[:, 0].max() + 2.2 * side)
    picture = picture_of([view])
    assert detector_for([target_of(other)]).detect(picture)
    for shown in (picture, np.ascontiguousarray(picture[:, :end])):
        assert not detector_for([target_of(FACE)]).detect(shown)
