"""Wild corners are told from boards that are somewhere else."""

import numpy as np
import pytest

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.sightings import without_wild

LIMIT = Events().wild_score


def board(seed: int, shift: np.ndarray, count: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Corners' derivatives by a pose, and residuals of a board that is off by a shift (6,)."""
    random = np.random.default_rng(seed)
    by_pose = 50 * random.normal(size=(count, 2, 6))
    return by_pose, -(by_pose @ shift) + random.normal(size=(count, 2))


@pytest.mark.parametrize("seed", range(5))
def test_wild_corners_are_found_beside_a_board_that_is_off(seed: int) -> None:
    by_pose, residual = board(seed, np.full(6, 0.5))
    residual[[3, 17, 30]] += [[80.0, 0.0], [0.0, -200.0], [-40.0, 40.0]]
    step, wild = without_wild(by_pose, residual, LIMIT)
    assert set(np.flatnonzero(wild)) >= {3, 17, 30}
    assert wild.sum() <= 4  # one good one in ten thousand is left out too
    np.testing.assert_allclose(step, 0.5, atol=0.02)


def test_no_corner_of_a_board_that_is_off_is_wild() -> None:
    by_pose, residual = board(7, np.full(6, 3.0))
    _, wild = without_wild(by_pose, residual, LIMIT)
    assert not np.any(wild)


def test_corners_that_show_no_board_are_kept_as_they_are() -> None:
    random = np.random.default_rng(1)
    by_pose, residual = board(2, np.zeros(6), 12)
    _, wild = without_wild(by_pose, residual + 500 * random.normal(size=residual.shape), LIMIT)
    assert np.sum(~wild) >= 4
