"""The one rule: located where all but EVIDENCE of the posterior is at one place."""

import math

import numpy as np

from trigpoint.fusion.association.events import EVIDENCE, window
from trigpoint.fusion.association.explanation import Place, alternatives_of, are_same_place
from trigpoint.geometry import Pose

COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])


def place(x: float, score: float) -> Place:
    return Place(Pose.from_vector([x, 0, 1, 0, 0, 0]), COVARIANCE, score)


def test_place_that_is_worse_by_the_window_is_no_alternative() -> None:
    assert len(alternatives_of([place(0, 0.0), place(1, window() + 0.1)])) == 1
    assert len(alternatives_of([place(0, 0.0), place(1, window() - 0.1)])) == 2


def test_many_unlikely_places_count_together() -> None:
    each = -2 * math.log(EVIDENCE / 5)
    many = [place(float(x), each) for x in range(1, 11)]
    assert len(alternatives_of([place(0, 0.0), *many])) > 1


def test_explanations_that_agree_on_the_place_are_one() -> None:
    found = alternatives_of([place(0, 3.0), place(0.02, 0.0), place(2, 1.0)])
    assert len(found) == 2
    assert np.isclose(found[0].probability, 1 - found[1].probability)
    assert found[0].probability > found[1].probability
    assert found[0].map_from_camera.translation[0] == 0.02


def test_same_place_goes_by_sigmas_in_each_direction() -> None:
    apart = np.array([[x, 0, 0, 0, 0, 0] for x in (0.049, -0.049, 0.051)])
    assert are_same_place(apart, COVARIANCE).tolist() == [True, True, False]


def test_place_that_is_hardly_known_is_no_excuse_for_one_that_is_well_known() -> None:
    """A camera given out to a centimetre is not there if it may be half a metre off."""
    vague = Place(place(0.5, 1.0).map_from_camera, np.diag([0.1] * 6), 1.0)
    assert len(alternatives_of([place(0, 0.0), vague])) == 2


def test_nothing_explained_is_no_place() -> None:
    assert alternatives_of([]) == ()


def test_a_place_that_is_no_number_is_one_of_its_own() -> None:
    nowhere = Place(Pose(np.eye(3), np.full(3, np.nan)), COVARIANCE, 0.0)
    assert len(alternatives_of([nowhere, place(0, 0.0), nowhere])) == 3
