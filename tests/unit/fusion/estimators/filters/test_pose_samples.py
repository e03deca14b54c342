"""Samples of a pose: their mean, and the disturbances from it."""

import numpy as np
import pytest

from trigpoint.fusion.estimators.filters.pose_samples import PoseSamples
from trigpoint.geometry import Pose

_PLACE = Pose.from_vector([3.0, -2.0, 0.5, 0.4, -1.2, 2.0])


@pytest.mark.parametrize("sigma", [0.0, 1e-3, 0.5])
def test_disturbances_from_the_mean_add_up_to_nothing(sigma: float) -> None:
    drawn = np.random.default_rng(3).gamma(1.0, sigma, (300, 6))  # skewed
    samples = PoseSamples.of(_PLACE.repeated(300).disturbed(drawn))
    np.testing.assert_allclose(samples.disturbances.mean(axis=0), 0.0, atol=1e-9)
    again = samples.mean.repeated(300).disturbed(samples.centred.disturbances)
    np.testing.assert_allclose(again.rotation, samples.poses.rotation, atol=1e-12)


def test_redrawn_samples_lie_where_their_disturbances_say() -> None:
    random = np.random.default_rng(4)
    samples = PoseSamples.of(_PLACE.repeated(200).disturbed(random.normal(0, 0.01, (200, 6))))
    moved = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.03])
    redrawn = PoseSamples(samples.about, samples.disturbances + moved)
    np.testing.assert_allclose(redrawn.mean.difference(samples.mean), moved, atol=1e-5)
    np.testing.assert_allclose(redrawn.centred.disturbances, samples.disturbances, atol=1e-3)
