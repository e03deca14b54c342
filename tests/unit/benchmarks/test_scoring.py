"""What a finder is credited with."""

import numpy as np
import pytest
from support.pictures.boards import checkerboard

from benchmarks.pictures.scoring import UNSAID, Score, score_of
from benchmarks.pictures.views import TrueFace, View
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry.rotation import Array

BOARD = checkerboard()
PIXELS = 1000 * BOARD.corners[:, :2]


def score(off: Array, sigma: float) -> Score:
    """Of a face whose corners are `off` (n, 2) from the truth."""
    view = View(np.zeros((4, 4), np.uint8), (TrueFace(BOARD, PIXELS, True),))
    ids = np.arange(BOARD.corner_count)
    return score_of([view], [[FaceSighting("", BOARD.id, ids, PIXELS + off, sigma)]])


def test_error_is_told_in_the_sigmas_that_were_said() -> None:
    off = np.random.default_rng(0).normal(0.0, 0.01, PIXELS.shape)
    found = score(off, 0.02)
    assert found.rms() == pytest.approx(float(np.sqrt(np.mean(off**2))))
    assert found.normalised_rms == pytest.approx(found.rms() / 0.02)


def test_finder_that_says_no_sigma_has_no_error_in_sigmas() -> None:
    found = score(np.full(PIXELS.shape, 0.5), UNSAID)
    assert found.rms() == pytest.approx(0.5)
    assert found.normalised_rms == 0.0
