"""AprilGrids: tag ids, corner order and where blurred tags end."""

import cv2
import numpy as np
import pytest
from support.pictures.boards import (
    aprilgrid,
    cluttered_picture,
    picture_of,
    placed,
    plain_picture,
    target_of,
    true_pixels,
    worst_error,
)

from trigpoint.edge.detector import detector_for


@pytest.mark.parametrize("border_bits", [1, 2])
@pytest.mark.parametrize("turn_deg", [0, 90, 180, 255])
def test_corners_go_clockwise_from_each_tags_top_left(turn_deg: float, border_bits: int) -> None:
    grid = aprilgrid(border_bits=border_bits, first=5)
    view = placed(grid, distance=0.8, turn_deg=turn_deg, tilt_deg=20, yaw_deg=15)
    (face,) = detector_for([target_of(grid)]).detect(picture_of([view]))
    assert face.corners.tolist() == list(range(grid.corner_count))
    assert worst_error(face.pixels, face.corners, view) < 0.3


def test_border_of_other_width_is_another_grid() -> None:
    picture = picture_of([placed(aprilgrid(border_bits=1), distance=0.8)])
    assert detector_for([target_of(aprilgrid(border_bits=2))]).detect(picture) == ()


def test_hidden_tags_leave_the_others_their_numbers() -> None:
    grid = aprilgrid()
    view = placed(grid, distance=0.9)
    picture = picture_of([view])
    truth = true_pixels(view)
    x, y = truth[:4].mean(axis=0)
    cv2.circle(picture, (round(x), round(y)), 25, 120, -1)
    (face,) = detector_for([target_of(grid)]).detect(picture)
    assert set(range(4)).isdisjoint(face.corners.tolist())
    assert len(face.corners) >= 40
    assert worst_error(face.pixels, face.corners, view) < 0.3


@pytest.mark.parametrize(("border_bits", "most"), [(1, 0.2), (2, 0.05)])
def test_blur_does_not_shrink_tags(border_bits: int, most: float) -> None:
    grid = aprilgrid(border_bits=border_bits)
    view = placed(grid, distance=0.8)
    (face,) = detector_for([target_of(grid)]).detect(picture_of([view], blur_px=1.5))
    truth = true_pixels(view)
    tags = truth.reshape(-1, 4, 2).mean(axis=1).repeat(4, axis=0)[face.corners.astype(int)]
    outward = truth[face.corners.astype(int)] - tags
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    error = face.pixels - truth[face.corners.astype(int)]
    assert abs(np.mean(np.sum(error * outward, axis=-1))) < most  # cornerSubPix: 0.46


def test_faces_of_one_picture_are_told_apart() -> None:
    faces = [aprilgrid(3, 2), aprilgrid(3, 2, number=1, first=6)]
    views = [
        placed(faces[0], x=-0.22, distance=1.0, yaw_deg=20),
        placed(faces[1], x=0.2, distance=1.1),
    ]
    found = detector_for([target_of(*faces)]).detect(picture_of(views, noise=2.0))
    assert sorted(face.face for face in found) == [0, 1]
    for face in found:
        assert worst_error(face.pixels, face.corners, views[face.face]) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_found_in_clutter(seed: int) -> None:
    assert detector_for([target_of(aprilgrid())]).detect(cluttered_picture(seed)) == ()


@pytest.mark.parametrize("noise", [0.0, 40.0])
def test_nothing_is_found_in_noise(noise: float) -> None:
    assert detector_for([target_of(aprilgrid())]).detect(plain_picture(noise=noise)) == ()
