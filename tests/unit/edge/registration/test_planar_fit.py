"""The fit of a flat face: lens distortion is no noise, a wild corner is."""

import numpy as np
import pytest
from support.pictures.boards import CAMERA, checkerboard, placed, true_pixels
from support.pictures.sound_corners import scatter_about, sound_corners

from trigpoint.edge.registration.plane_fitting import fit_plane
from trigpoint.geometry import CameraModel

BOARD = checkerboard(9, 7)
POINTS = BOARD.corners[:, :2]
SIZE = (640, 480)


def seen(sigma: float, seed: int = 0, camera: CameraModel = CAMERA) -> np.ndarray:
    view = placed(BOARD, distance=0.5, tilt_deg=30, yaw_deg=20, turn_deg=10)
    return true_pixels(view, camera) + np.random.default_rng(seed).normal(0, sigma, (48, 2))


def test_exact_corners_are_predicted_through_the_lens() -> None:
    pixels = seen(0.0)
    fit = fit_plane(POINTS[::2], pixels[::2], SIZE)
    assert fit is not None
    assert np.abs(fit.project(POINTS) - pixels).max() < 0.05


def test_face_that_begins_behind_the_camera_is_fitted_by_what_is_seen() -> None:
    """The floor's board below a camera that looks along it."""
    points = np.stack(np.meshgrid(np.arange(9) * 0.1, np.arange(7) * 0.1), axis=-1).reshape(-1, 2)
    depth = 0.25 + np.sin(np.radians(60)) * (points[:, 0] - 0.4)
    across = np.cos(np.radians(60)) * (points[:, 0] - 0.4)
    assert depth[0] < 0
    shown = depth > 0.05
    aside = np.stack([across, points[:, 1] - 0.3], axis=1)[shown]
    pixels = 200.0 * aside / depth[shown, None] + np.array([320.0, 240.0])
    fit = fit_plane(points[shown], pixels, SIZE, has_lens=False)
    assert fit is not None
    assert np.abs(fit.project(points[shown]) - pixels).max() < 1e-6


@pytest.mark.parametrize("k1", [-0.35, 0.0, 0.2])
def test_no_corner_is_wild_for_the_lens(k1: float) -> None:
    camera = CameraModel(640, 480, 400.0, 400.0, 325.0, 235.0, (k1, 0.08, 0, 0, 0))
    keep, _ = sound_corners(POINTS, seen(0.1, camera=camera), SIZE)
    assert keep.all()


def test_wild_corners_are_dropped_and_no_others() -> None:
    pixels = seen(0.1)
    pixels[[5, 20, 21]] += [[4.0, 0.0], [0.0, -9.0], [15.0, 15.0]]
    keep, _ = sound_corners(POINTS, pixels, SIZE)
    assert np.flatnonzero(~keep).tolist() == [5, 20, 21]


def test_scattered_points_are_no_face() -> None:
    pixels = np.random.default_rng(0).uniform(0, 480, (48, 2))
    keep, _ = sound_corners(POINTS, pixels, SIZE)
    assert keep.sum() < 12


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_points_fix_no_plane(count: int) -> None:
    assert fit_plane(POINTS[:count], seen(0.0)[:count], SIZE) is None
    assert not sound_corners(POINTS[:count], seen(0.0)[:count], SIZE)[0].any()


def test_points_on_a_line_fix_no_plane_that_lies() -> None:
    line = POINTS[:8]
    fit = fit_plane(line, seen(0.0)[:8], SIZE)
    assert fit is None or np.isfinite(fit.project(line)).all()


def test_few_corners_at_the_edge_of_a_picture_do_not_run_away() -> None:
    """Six sound corners of a half-hidden face of 5 x 4 squares, as an agent measured them."""
    numbers = np.array([2, 3, 5, 6, 7, 11])
    points = np.column_stack([numbers % 4, numbers // 4]) * 0.06
    pixels = np.array(
        [
            [10.885198, 319.77066],
            [21.568577, 305.46185],
            [7.8312583, 353.74243],
            [18.772213, 338.31488],
            [28.412207, 323.57617],
            [42.62961, 344.8857],
        ]
    )
    keep, _ = sound_corners(points, pixels, SIZE)
    assert keep.sum() >= 5


def test_corners_that_all_scatter_are_none() -> None:
    pixels = seen(0.0) + np.random.default_rng(3).normal(0, 8.0, (48, 2))
    assert not sound_corners(POINTS, pixels, SIZE)[0].any()


@pytest.mark.parametrize("has_lens", [False, True])
def test_scatter_is_that_of_the_corners_and_not_of_the_lens(has_lens: bool) -> None:
    """Also where the fit was left without one, since all came near enough."""
    camera = CameraModel(640, 480, 540.0, 540.0, 322.0, 237.0, (-0.02, 0.0, 2e-4, -2e-4, 0.0))
    squares, freedom = 0.0, 0
    for seed in range(8):
        pixels = seen(0.01, seed, camera)
        fit = fit_plane(POINTS, pixels, SIZE, has_lens=has_lens)
        assert fit is not None
        one, more = scatter_about(fit, POINTS, pixels)
        squares, freedom = squares + one, freedom + more
    assert freedom == 8 * (96 - 10)
    assert np.sqrt(squares / freedom) == pytest.approx(0.01, rel=0.08)


def test_corners_that_any_plane_and_lens_meet_scatter_not() -> None:
    pixels = seen(0.3)[:5]
    fit = fit_plane(POINTS[[0, 3, 20, 40, 47]], pixels, SIZE)
    assert fit is not None
    assert scatter_about(fit, POINTS[[0, 3, 20, 40, 47]], pixels) == (0.0, 0)
