"""Wild corners are told from boards that are somewhere else."""

import numpy as np
import pytest
from support.builders import make_target
from support.fusion.drives import lens

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.sightings import all_without_wild, by_itself
from trigpoint.fusion.model.observations import Reading, View, face_points
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3

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
