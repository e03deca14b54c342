"""The smoother's poses and covariances against GTSAM's on the same problem, an oracle that shares
nothing with it but the residuals' definition."""

import pytest

pytest.importorskip("gtsam", reason="gtsam is not installed; pip install -e '.[bench]'")

from benchmarks.fusion.gtsam_comparison import (
    difference,
    native,
    problem_of,
    reprojection,
    smoothed,
    solved_by,
)
from trigpoint.fusion.model.problem import Problem, State


@pytest.fixture(scope="module")
def problem() -> tuple[Problem, State]:
    return problem_of("drive", seed=1)


def test_the_same_residuals_give_the_same_poses_and_covariances(
    problem: tuple[Problem, State],
) -> None:
    apart = difference(smoothed(*problem), solved_by(reprojection, *problem))
    assert apart.poses < 0.01
    assert apart.sigmas < 0.01


def test_relative_poses_of_single_pictures_give_nearly_the_same(
    problem: tuple[Problem, State],
) -> None:
    apart = difference(smoothed(*problem), solved_by(native, *problem))
    assert apart.poses < 0.05
    assert apart.sigmas < 0.05
