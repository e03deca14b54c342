"""A face is found_by_template where it went, and not where it is not."""

import numpy as np
import pytest
from support.pictures.boards import (
    aprilgrid,
    charuco,
    checkerboard,
    picture_of,
    placed,
    plain_picture,
    true_pixels,
)

from trigpoint.edge.registration.corner_pattern import CornerPattern
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.edge.registration.plane_fitting import fit_plane
from trigpoint.edge.registration.template_search import found_by_template
from trigpoint.site.target import Face

FACES = [checkerboard(8, 5), charuco(), aprilgrid()]
MOVED_PX = np.array([14.0, -9.0])


def fit_before(face: Face, pixels: np.ndarray, picture: np.ndarray) -> PlanarFit:
    """The plane of a face that was so much further left and down."""
    size = (picture.shape[1], picture.shape[0])
    fit = fit_plane(face.corners[:, :2], pixels - MOVED_PX, size)
    assert fit is not None
    return fit


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.pattern.value)
def test_face_is_found_by_template_to_a_pixel_where_it_moved(face: Face) -> None:
    view = placed(face, distance=0.9, yaw_deg=20, tilt_deg=10)
    picture = picture_of([view], noise=2.0)
    pixels = true_pixels(view)
    there = found_by_template(
        picture, CornerPattern.of(face), fit_before(face, pixels, picture), 24.0
    )
    assert there is not None
    off = there.project(face.corners[:, :2]) - pixels
    assert np.abs(off).max() < 1.5


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.pattern.value)
def test_nothing_is_found_by_template_where_the_face_is_gone(face: Face) -> None:
    picture = plain_picture(noise=2.0)
    pixels = true_pixels(placed(face, distance=0.9))
    fit = fit_before(face, pixels, picture)
    assert found_by_template(picture, CornerPattern.of(face), fit, 24.0) is None


def test_face_at_the_edge_of_the_picture_is_found_by_template_in_part() -> None:
    face = charuco()
    view = placed(face, distance=0.9, x=-0.56)
    picture = picture_of([view], noise=2.0)
    pixels = true_pixels(view)
    assert pixels.min() < 0
    there = found_by_template(
        picture, CornerPattern.of(face), fit_before(face, pixels, picture), 24.0
    )
    assert there is not None
    assert np.abs(there.project(face.corners[:, :2]) - pixels).max() < 2.0
