"""What is measured of a face in a picture: its size, its sharpness, its motion."""

import cv2
import numpy as np
import pytest
from support.pictures.boards import (
    CAMERA,
    Placed,
    charuco,
    picture_of,
    placed,
    target_of,
    true_pixels,
)

from trigpoint.edge.tracker import TargetTracker
from trigpoint.tools.look.seen import READOUT_S, Seen, Watch

TENTH_NS = 100_000_000


def seen_in(
    views: list[Placed], *, blur_px: float = 0.4, moved_px: int = 1, apart_ns: int = TENTH_NS
) -> list[Seen]:
    """The board in pictures of these places, one after the other, each smeared to the side."""
    tracker, watch, found = TargetTracker([target_of(charuco())]), Watch(), []
    for number, view in enumerate(views, 1):
        stamp_ns = number * apart_ns
        picture = picture_of([view], noise=1.0, blur_px=blur_px, seed=number)
        tracker.detect(cv2.blur(picture, (moved_px, 1)), stamp_ns)
        found += watch.seen(tracker.located, stamp_ns, CAMERA.height)
    return found


def test_a_square_is_as_large_as_it_is_in_the_picture() -> None:
    view = placed(charuco(), distance=0.7)
    (seen,) = seen_in([view])
    corners = true_pixels(view).reshape(3, 4, 2)
    assert seen.corners == 12
    assert seen.square_px == pytest.approx(np.linalg.norm(corners[1, 2] - corners[1, 1]), rel=0.02)


def test_blur_widens_edges_and_is_said() -> None:
    view = placed(charuco(), distance=0.6)
    (sharp,), (soft,), (blurred,) = (seen_in([view], blur_px=blur) for blur in (1.0, 1.5, 3.0))
    assert sharp.sharpness.endswith("px wide, sharp")
    # From a tenth to nine tenths of a Gaussian step are 2.56 sigmas.
    assert sharp.edge_px == pytest.approx(2.56 * 1.0, rel=0.1)
    assert soft.edge_px == pytest.approx(2.56 * 1.5, rel=0.1)
    assert "soft: see to the lens's focus" in soft.sharpness
    assert "or more, blurred: see to the lens's focus" in blurred.sharpness
    assert blurred.sigma_px > sharp.sigma_px


def test_blur_along_one_direction_is_motion() -> None:
    (seen,) = seen_in([placed(charuco(), distance=0.6)], moved_px=9)
    assert "by motion: hold it still" in seen.sharpness


def test_motion_is_measured_where_pictures_follow_each_other() -> None:
    places = [placed(charuco(), x=0.004 * step) for step in range(3)]
    way_px = np.linalg.norm(true_pixels(places[1])[0] - true_pixels(places[0])[0])
    *_, last = seen_in(places)
    assert last.speed_px == pytest.approx(10 * way_px, rel=0.1)
    height = np.ptp(true_pixels(places[2])[:, 1]) / CAMERA.height
    assert last.bend_px == pytest.approx(last.speed_px * READOUT_S * height, rel=0.05)
    still = seen_in(places, apart_ns=10 * TENTH_NS)
    assert [one.speed_px for one in still] == [0, 0, 0]
