"""Held against `best_reading`, which looks at one view after the other."""

import numpy as np
import pytest

from trigpoint.fusion.model.observations import Observation, Reading, View, observation_of
from trigpoint.fusion.reading import faces
from trigpoint.fusion.reading.unambiguous import are_visible, is_unambiguous
from trigpoint.fusion.reading.visibility import by_reading, outermost
from trigpoint.geometry import CameraModel, Pose
from trigpoint.target import Target
from trigpoint.tools.simulation.targets import target_of

LENS = CameraModel.from_field_of_view(640, 480, np.radians(60.0))


def random_observation(target: Target, random: np.random.Generator) -> Observation:
    views = []
    for face in random.choice(len(target.faces), random.integers(1, 4), replace=False):
        count = int(random.integers(1, target.faces[face].corner_count + 1))
        corners = np.sort(random.choice(target.faces[face].corner_count, count, replace=False))
        pixels = random.uniform(0.0, 480.0, (count, 2))
        if random.random() < 0.2:
            pixels = np.round(pixels, -2)  # corners that reach equally far
        reading = Reading(int(face), bool(random.random() < 0.5))
        views.append(View(corners, pixels, 0.2, (reading,)))
    return observation_of("c1", "r1", 0, tuple(views))


@pytest.mark.parametrize("kind", ["charuco", "checkerboard"])
def test_plain_observations_are_possible_where_each_of_their_views_can_be_read(kind: str) -> None:
    target, random = target_of(kind), np.random.default_rng(2)
    observations = [random_observation(target, random) for _ in range(300)]
    vectors = random.normal(0.0, [0.6, 0.6, 0.6, 1.5, 1.5, 1.5], (300, 6))
    poses = Pose.from_vector(vectors + np.eye(6)[2])
    found = are_visible(observations, target, poses)
    expected = [
        all(
            np.isfinite(faces.best_reading(view, target, LENS, poses[row])[1])
            for view in observation.views
        )
        for row, observation in enumerate(observations)
    ]
    np.testing.assert_array_equal(found, expected)
    assert 20 < np.sum(found) < 280  # both happen


def test_observation_with_an_open_reading_is_not_plain() -> None:
    view = View(np.arange(4), np.zeros((4, 2)), 0.2, (Reading(0), Reading(0, is_turned=True)))
    assert not is_unambiguous(observation_of("c1", "r1", 0, (view,)))


def test_turned_reading_names_corners_from_the_other_end() -> None:
    target = target_of("checkerboard")
    body = faces.body_of(target)
    corners = np.array([0, 3, 7])
    both = (Reading(2), Reading(2, is_turned=True))
    upright, turned = by_reading(View(corners, np.zeros((3, 2)), 0.2, both), body)
    np.testing.assert_array_equal(upright, body.corners[2][corners])
    np.testing.assert_array_equal(turned, body.corners[2][::-1][corners])


def test_outermost_corners_are_each_named_once() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])
    np.testing.assert_array_equal(outermost(square), [0, 1, 2, 3])
    np.testing.assert_array_equal(outermost(square[:1]), [0])
