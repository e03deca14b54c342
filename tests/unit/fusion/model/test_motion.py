"""The way within the plane is held against the one that any way takes."""

import numpy as np
import pytest

from trigpoint.fusion.model.motion import (
    UNKNOWN_VARIANCE,
    StepNoise,
    composed_in_plane,
    composed_motion,
)


def steps_in_plane(
    random: np.random.Generator, *, unknown: int
) -> tuple[np.ndarray, StepNoise, np.ndarray]:
    twists = np.zeros((60, 6))
    twists[:, [0, 1, 5]] = random.normal(0.0, [0.05, 0.01, 0.2], (60, 3))
    twists[10:14, 5] = [0.0, 1e-9, -3e-5, 2e-4]  # straight on, or nearly so
    twists[30:35] = 0.0
    noise = StepNoise(
        along=random.uniform(0.0, 1e-4, (60, 3)),
        slip=random.uniform(0.0, 1e-5, 60),
        tilt=random.uniform(0.0, 1e-6, 60),
        heading=random.uniform(0.0, 1e-4, 60),
        is_unknown=np.isin(np.arange(60), random.choice(60, unknown, replace=False)),
    )
    segment = np.repeat(np.arange(9), [1, 9, 5, 15, 5, 1, 1, 3, 20])
    return twists, noise, segment


@pytest.mark.parametrize("unknown", [0, 2])
@pytest.mark.parametrize("scales", [(0.0, 0.0), (0.03, -0.05)])
def test_motion_in_the_plane_is_composed_as_any_other(
    unknown: int, scales: tuple[float, float]
) -> None:
    twists, noise, segment = steps_in_plane(np.random.default_rng(3), unknown=unknown)
    found = composed_in_plane(twists, noise, segment, np.array(scales))
    expected = composed_motion(twists, noise, segment, np.array(scales))
    pose, other = found.earlier_from_later, expected.earlier_from_later
    np.testing.assert_allclose(pose.rotation, other.rotation, rtol=0, atol=1e-14)
    np.testing.assert_allclose(pose.translation, other.translation, rtol=0, atol=1e-14)
    largest = UNKNOWN_VARIANCE if unknown else 1e-3
    np.testing.assert_allclose(
        found.covariance, expected.covariance, rtol=1e-12, atol=1e-14 * largest
    )
    np.testing.assert_allclose(found.by_scale, expected.by_scale, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found.is_still, expected.is_still)
    assert found.is_still.tolist() == [False] * 4 + [not np.any(noise.is_unknown[30:35])] + (
        [False] * 4
    )
