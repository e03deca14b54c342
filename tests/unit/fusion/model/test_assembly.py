"""Held against `points_of`, which takes one observation after the other."""

import numpy as np

from trigpoint.fusion.model.assembly import padded_points
from trigpoint.fusion.model.observations import (
    Observation,
    Reading,
    View,
    observation_of,
    points_of,
)
from trigpoint.fusion.model.rolling_shutter import sweep_of
from trigpoint.site.config import CameraConfig
from trigpoint.site.target import Target
from trigpoint.tools.simulation.sight.targets import target_of

ROLLING = CameraConfig("sim://c1", line_delay=30e-6)


def random_observation(target: Target, random: np.random.Generator) -> Observation:
    views, rolls = [], random.random() < 0.5
    for face in random.choice(len(target.faces), random.integers(1, 4), replace=False):
        count = int(random.integers(1, target.faces[face].corner_count + 1))
        corners = np.sort(random.choice(target.faces[face].corner_count, count, replace=False))
        reading = Reading(int(face), bool(random.random() < 0.5))
        sigma = float(random.uniform(0.1, 1.0))
        pixels = random.uniform(0.0, 480.0, (count, 2))
        sweep = sweep_of(ROLLING, pixels) if rolls else None
        views.append(View(corners, pixels, sigma, (reading,), sweep))
    twist = random.uniform(-1.0, 1.0, 6)
    observation = observation_of("c1", "r1", 0, tuple(views)).moving(twist)
    if random.random() < 0.5:
        return observation
    return observation.with_outliers(tuple(random.random(len(v.corners)) < 0.3 for v in views))


def test_padded_rows_are_the_points_of_each_observation_and_zeros() -> None:
    target, random = target_of("charuco"), np.random.default_rng(5)
    observations = [random_observation(target, random) for _ in range(40)]
    padded = padded_points(observations, target)
    assert padded.weights.shape[1] == max(o.corner_count for o in observations)
    for row, observation in enumerate(observations):
        expected, count = points_of(observation, target), observation.corner_count
        for name in ("face_points", "faces", "pixels", "weights"):
            table = getattr(padded, name)[row]
            np.testing.assert_allclose(table[:count], getattr(expected, name), atol=1e-14)
            assert not np.any(table[count:])
