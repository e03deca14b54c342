"""Wild corners are told from boards that are somewhere else; a plane has two poses, and none where
the corners do not say."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.builders import make_target
from support.fusion.drives import lens

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.sightings import all_without_wild, by_itself, planar_poses
from trigpoint.fusion.model.observations import Reading, View, face_points
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array

LIMIT = Events().wild_score


def without_wild(by_pose: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same of one board by itself."""
    (step,), (wild,) = all_without_wild(by_pose[None], residual[None], LIMIT)
    return step, wild


def board(seed: int, shift: np.ndarray, count: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Corners' derivatives by a pose, and residuals of a board that is off by a shift (6,)."""
    random = np.random.default_rng(seed)
    by_pose = 50 * random.normal(size=(count, 2, 6))
    return by_pose, -(by_pose @ shift) + random.normal(size=(count, 2))


@pytest.mark.parametrize("seed", range(5))
def test_wild_corners_are_found_beside_a_board_that_is_off(seed: int) -> None:
    by_pose, residual = board(seed, np.full(6, 0.5))
    residual[[3, 17, 30]] += [[80.0, 0.0], [0.0, -200.0], [-40.0, 40.0]]
    step, wild = without_wild(by_pose, residual)
    assert set(np.flatnonzero(wild)) >= {3, 17, 30}
    assert wild.sum() <= 4  # one good one in ten thousand is left out too
    np.testing.assert_allclose(step, 0.5, atol=0.02)


def test_no_corner_of_a_board_that_is_off_is_wild() -> None:
    by_pose, residual = board(7, np.full(6, 3.0))
    _, wild = without_wild(by_pose, residual)
    assert not np.any(wild)


def test_corners_that_show_no_board_are_kept_as_they_are() -> None:
    random = np.random.default_rng(1)
    by_pose, residual = board(2, np.zeros(6), 12)
    _, wild = without_wild(by_pose, residual + 500 * random.normal(size=residual.shape))
    assert np.sum(~wild) >= 4


def test_many_sightings_are_judged_as_each_by_itself() -> None:
    random = np.random.default_rng(4)
    boards = [board(seed, np.full(6, 0.1 * seed), 24) for seed in range(40)]
    for seed, (_, residual) in enumerate(boards):
        wild = random.choice(24, seed % 22, replace=False)
        residual[wild] += 60 * random.normal(size=(len(wild), 2))
    boards[3][0][:, :, 4] = 0.0  # a direction that no corner shows
    by_pose, residual = (np.stack(each) for each in zip(*boards, strict=True))
    steps, wild = all_without_wild(by_pose, residual, LIMIT)
    for row in range(40):
        step, flags = without_wild(by_pose[row], residual[row])
        np.testing.assert_allclose(steps[row], step, atol=1e-9)
        np.testing.assert_array_equal(wild[row], flags)
        kept = by_pose[row][~flags].reshape(-1, 6)
        least = np.linalg.lstsq(kept, -residual[row][~flags].reshape(-1), rcond=1e-12)[0]
        np.testing.assert_allclose(step, least, atol=1e-8)
    assert 100 < np.sum(wild) < 500


@pytest.mark.parametrize(("count", "boards"), [(12, 100), (48, 25)])
def test_wild_corners_do_not_spoil_the_fit_of_a_board_by_itself(count: int, boards: int) -> None:
    target, camera = make_target(), lens()
    face = target.faces[0]
    missed = 0
    for seed in range(boards):
        random = np.random.default_rng(seed)
        corners = np.sort(random.choice(48, count, replace=False))
        points = face_points(face, corners, is_turned=False)
        place = np.append(random.uniform(-0.3, 0.3, 2), random.uniform(1.5, 3.0))
        pixels = camera.project(Pose(so3.exp(random.normal(0, 0.5, 3)), place) @ points)
        pixels += random.normal(0, 0.1, pixels.shape)
        wild = random.choice(count, 2, replace=False)
        spoilt = pixels.copy()
        spoilt[wild] += random.choice([-1, 1], (2, 2)) * random.uniform(20, 60, (2, 2))
        good, found = (
            by_itself(View(corners, each, 0.1, (Reading(0),)), camera, target, Events())
            for each in (pixels, spoilt)
        )
        missed += set(np.flatnonzero(found.wild)) != {*wild, *np.flatnonzero(good.wild)}
    assert missed == 0


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
