"""Laying a map over surveyed points."""

import numpy as np
import pytest

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.survey import Laying, SurveyedPoint, lay

TRUE = Pose.from_vector([12.0, -3.0, 4.0, 0.0, 0.0, 2.5])
TILTED = Pose.from_vector([12.0, -3.0, 4.0, 0.1, -0.2, 2.5])
PLACES = np.array(
    [[0.2, 0.2, 2.4], [7.8, 0.2, 2.4], [4.0, 5.8, 2.9], [0.2, 5.8, 2.4], [9.0, 6.0, 2.0]]
)
SURVEY_M = 0.01


def joint_covariance(rng: np.random.Generator, count: int) -> Array:
    """Cameras that err together, as those of one drive do."""
    root = rng.normal(size=(3 * count, 3 * count)) * 0.004
    return root @ root.T


def points(in_map: Array, in_frame: Array, *, dimensions: int = 3) -> list[SurveyedPoint]:
    return [
        SurveyedPoint(f"c{i + 1}", ours, theirs[:dimensions], SURVEY_M)
        for i, (ours, theirs) in enumerate(zip(in_map, in_frame, strict=True))
    ]


def drawn(
    rng: np.random.Generator, frame_from_map: Pose, *, blunder: Array | None = None
) -> tuple[list[SurveyedPoint], Array]:
    """Points with errors as their covariances say; `blunder` (3,): of the third."""
    covariance = joint_covariance(rng, len(PLACES))
    in_map = PLACES + rng.multivariate_normal(np.zeros(15), covariance).reshape(-1, 3)
    in_frame = frame_from_map @ PLACES + rng.normal(scale=SURVEY_M, size=PLACES.shape)
    if blunder is not None:
        in_frame[2] += blunder
    return points(in_map, in_frame), covariance


def error_of(laying: Laying, true: Pose, unknowns: list[int]) -> float:
    """Against its own covariance, by degree of freedom."""
    off = laying.frame_from_map.difference(true)[unknowns]
    return float(off @ np.linalg.solve(laying.covariance[np.ix_(unknowns, unknowns)], off)) / len(
        unknowns
    )


@pytest.mark.parametrize(
    ("true", "is_level", "unknowns"),
    [(TRUE, True, [0, 1, 2, 5]), (TILTED, False, [0, 1, 2, 3, 4, 5])],
)
def test_covariance_is_that_of_the_errors(true: Pose, is_level: bool, unknowns: list[int]) -> None:
    rng = np.random.default_rng(3)
    found = [lay(*drawn(rng, true), is_level=is_level) for _ in range(50)]
    mean = np.mean([error_of(laying, true, unknowns) for laying in found])
    # χ² by its degrees of freedom has the variance 2 / dof.
    assert abs(mean - 1) < 4 * np.sqrt(2 / len(unknowns) / len(found))


def test_residuals_are_those_that_chance_gives() -> None:
    rng = np.random.default_rng(4)
    found = [lay(*drawn(rng, TRUE), is_level=True) for _ in range(50)]
    below = np.mean([one.probability < 0.1 for laying in found for one in laying.residuals])
    assert 0.05 < below < 0.16
    assert sum(bool(laying.outliers) for laying in found) <= 2


def test_a_point_that_was_surveyed_wrongly_is_named_and_left_out() -> None:
    rng = np.random.default_rng(5)
    surveyed, covariance = drawn(rng, TRUE, blunder=np.array([0.5, 0.0, 0.0]))
    laying = lay(surveyed, covariance, is_level=True)
    assert laying.outliers == ["c3"]
    third = laying.residuals[2]
    assert third.distance_m == pytest.approx(0.5, abs=0.1)
    without = [surveyed[i] for i in (0, 1, 3, 4)]
    rows = [3 * i + axis for i in (0, 1, 3, 4) for axis in range(3)]
    again = lay(without, covariance[np.ix_(rows, rows)], is_level=True)
    assert np.allclose(again.frame_from_map.translation, laying.frame_from_map.translation)


@pytest.mark.parametrize("is_level", [True, False])
def test_wrong_points_are_found_among_many(is_level: bool) -> None:
    rng = np.random.default_rng(6)
    places = rng.uniform([0, 0, 2], [60, 40, 4], (30, 3))
    in_frame = TRUE @ places + rng.normal(scale=SURVEY_M, size=places.shape)
    wrong = list(range(0, 30, 3))  # every third one
    in_frame[wrong] += rng.uniform(-2, 2, (10, 3))
    laying = lay(points(places, in_frame), 1e-5 * np.eye(90), is_level=is_level)
    assert laying.outliers == [f"c{i + 1}" for i in wrong]
    assert np.allclose(laying.frame_from_map.translation, TRUE.translation, atol=0.03)


def test_heights_that_nobody_surveyed_are_taken_from_the_map() -> None:
    surveyed = points(PLACES, TRUE @ PLACES, dimensions=2)
    laying = lay(surveyed, 1e-6 * np.eye(15), is_level=True)
    assert np.allclose(laying.frame_from_map.translation, [12.0, -3.0, 0.0])
    assert laying.frame_from_map.heading == pytest.approx(2.5)
    assert laying.covariance[2, 2] == 0.0


@pytest.mark.parametrize(
    ("numbers", "is_level", "said"),
    [
        ([0], True, "1 surveyed points are located in the map; 2 are needed"),
        ([0, 1], False, "2 surveyed points are located in the map; 3 are needed"),
        ([0, 0], True, "c1, c2 do not tell the map's direction; survey points that are further"),
    ],
)
def test_too_few_points_are_refused(numbers: list[int], is_level: bool, said: str) -> None:
    surveyed = points(PLACES[numbers], (TRUE @ PLACES)[numbers])
    with pytest.raises(InputError, match=said):
        lay(surveyed, 1e-6 * np.eye(3 * len(numbers)), is_level=is_level)


def test_points_in_a_line_tell_no_tilt() -> None:
    line = np.array([[0.0, 0, 1], [2, 0, 1], [5, 0, 1]])
    with pytest.raises(InputError, match="and not in a line"):
        lay(points(line, TRUE @ line), 1e-6 * np.eye(9), is_level=False)


def test_points_of_which_no_majority_agrees_are_refused() -> None:
    in_frame = TRUE @ PLACES[:3] + np.array([[0, 0, 0], [1.0, 0, 0], [0, 2.0, 0]])
    with pytest.raises(InputError, match=r"no majority of them agrees \(c1 by .* cm, c2"):
        lay(points(PLACES[:3], in_frame), 1e-6 * np.eye(9), is_level=True)
