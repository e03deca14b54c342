"""The contract's random walk, by its own numbers."""

import numpy as np
from numpy.testing import assert_allclose

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.site.config import OdometryNoise

NOISE = OdometryNoise(
    distance=0.006, lateral=0.002, vertical=0.001,
    tilt=0.003, heading_drive=0.004, tilt_turn=0.005, heading_turn=0.007,
)  # fmt: skip


def test_variances_grow_with_length_and_turn() -> None:
    found = step_variances(NOISE, [0.0, 2.0, 2.0], [1.5, 0.0, 1.5])
    assert_allclose(found.translation[0], 0.0)
    assert_allclose(found.translation[1:], [[72e-6, 8e-6, 2e-6]] * 2)
    assert_allclose(found.rotation[0], [37.5e-6, 37.5e-6, 73.5e-6])
    assert_allclose(found.rotation[1], [18e-6, 18e-6, 32e-6])
    assert_allclose(found.rotation[2], found.rotation[0] + found.rotation[1])


def test_many_short_steps_are_as_uncertain_as_a_long_one() -> None:
    short = step_variances(NOISE, np.full(50, 0.02), np.full(50, 0.01))
    long = step_variances(NOISE, 1.0, 0.5)
    assert_allclose(short.translation.sum(axis=0), long.translation)
    assert_allclose(short.rotation.sum(axis=0), long.rotation)
