"""Both poses of one plane, and none where the corners do not say."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.fusion.drives import lens

from trigpoint.fusion.association.sightings import planar_poses
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

SIGMA = 0.1


def grid(columns: int = 5, rows: int = 4, square: float = 0.06) -> Array:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * square


def facing(tilt: float, azimuth: float, distance: float, spin: float = 0.0) -> Pose:
    """camera_from_face of a board before the camera whose normal is tilted from the axis."""
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    rotation = so3.exp(tilt * axis) @ so3.about_z(spin)
    return Pose(rotation, np.array([0.1, -0.05, distance]) - rotation @ grid().mean(axis=0))


def error(found: Pose, true: Pose) -> float:
    return float(np.abs(found.difference(true)).max())


@given(
    tilt=st.floats(0.0, 1.2),
    azimuth=st.floats(-3.1, 3.1),
    distance=st.floats(0.5, 3.0),
    spin=st.floats(-3.1, 3.1),
)
def test_truth_is_among_the_poses_of_exact_corners(
    tilt: float, azimuth: float, distance: float, spin: float
) -> None:
    model, true = lens(), facing(tilt, azimuth, distance, spin)
    optical = true @ grid()
    assume(bool(np.all(model.sees(optical))))
    found = planar_poses(model, grid(), model.project(optical), SIGMA)
    assert min(error(fit.pose, true) for fit in found) < 1e-6
    assert found == sorted(found, key=lambda fit: fit.rms)


def test_far_board_has_two_poses_that_fit_alike() -> None:
    model, true = lens(), facing(0.4, 0.3, 4.0)
    pixels = model.project(true @ grid())
    first, second = planar_poses(model, grid(), pixels, SIGMA)
    assert error(second.pose, first.pose) > 0.1
    assert second.rms < 2.0  # sigmas of a tenth of a pixel: no picture tells them apart


@given(st.integers(0, 1000))
def test_no_pose_is_mirrored_or_behind_the_camera(seed: int) -> None:
    random = np.random.default_rng(seed)
    model = lens()
    pixels = random.uniform([50, 50], [590, 430], (len(grid()), 2))
    for fit in planar_poses(model, grid(), pixels, SIGMA):
        assert np.linalg.det(fit.pose.rotation) == pytest.approx(1.0)
        assert np.all((fit.pose @ grid())[:, 2] > 0)


@pytest.mark.parametrize(
    "chosen",
    [slice(0, 3), slice(0, 5), slice(0, 0)],
    ids=["three corners", "one row of corners", "no corner"],
)
def test_too_few_corners_or_corners_on_a_line_give_no_pose(chosen: slice) -> None:
    model, true = lens(), facing(0.4, 0.3, 1.0)
    points = grid()[chosen]
    assert planar_poses(model, points, model.project(true @ points), SIGMA) == []


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of arithmetic with infinity
@pytest.mark.parametrize("wild", [np.nan, np.inf, 1e6])
def test_corner_without_a_direction_gives_no_pose_and_no_error(wild: float) -> None:
    model, true = lens(), facing(0.4, 0.3, 1.0)
    pixels = model.project(true @ grid())
    pixels[3] = wild
    for fit in planar_poses(model, grid(), pixels, SIGMA):
        assert np.all(np.isfinite(fit.pose.translation))
        assert np.isfinite(fit.rms)


def test_corners_all_at_one_place_give_no_nonsense() -> None:
    for fit in planar_poses(lens(), grid(), np.full((len(grid()), 2), 200.0), SIGMA):
        assert np.all(np.isfinite(fit.pose.translation))
        assert np.linalg.norm(fit.pose.translation) < 1e3


def test_lens_without_distortion_and_with_it_agree() -> None:
    true = facing(0.6, 2.0, 0.9)
    plain: CameraModel = lens(62.0, ())
    for model in (plain, lens(62.0, (-0.25, 0.08, 1e-3, -1e-3, 0.01))):
        best = planar_poses(model, grid(), model.project(true @ grid()), SIGMA)[0]
        assert error(best.pose, true) < 1e-6
