"""What is predicted of a part of a visit is what all others say, solved without it."""

import numpy as np
import pytest
from support.fusion.linear_visits import blocks, design, drawn_visit

from trigpoint.fusion.association.innovations import innovations
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL

ROOM = np.array([75.0, 75.0, 2.0, 3.0, 3.0, 3.0])


@pytest.mark.parametrize("d", [len(PLANAR), len(SPATIAL)])
def test_part_is_predicted_by_all_others_that_are_used(d: int) -> None:
    visit = drawn_visit(1, d)
    used = np.arange(len(visit.parts)) != 2
    error, spread = innovations(visit, used, ROOM)
    by, right = design(visit)
    information = np.linalg.inv(blocks(visit.own))
    assert error.shape == (len(used), 6)
    for part in range(len(used)):
        rows = np.repeat(used & (np.arange(len(used)) != part), 6)
        weight = np.zeros((len(right), len(right)))
        weight[: len(rows), : len(rows)] = information * np.outer(rows, rows)
        weight[len(rows) :, len(rows) :] = np.linalg.inv(blocks(visit.spread))
        prior = np.zeros(by.shape[1])
        prior[-len(visit.prior) :] = visit.prior
        prior[-len(visit.prior) :][:6] += 1 / ROOM
        covariance = np.linalg.inv(by.T @ weight @ by + np.diag(prior))
        mine = slice(6 * part, 6 * part + 6)
        expected = right[mine] - by[mine] @ covariance @ by.T @ weight @ right
        assert error[part] == pytest.approx(expected, rel=1e-6, abs=1e-9)
        assert spread[part] == pytest.approx(
            visit.own[part] + by[mine] @ covariance @ by[mine].T, rel=1e-6, abs=1e-12
        )
