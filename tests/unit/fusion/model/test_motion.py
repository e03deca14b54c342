"""The core's motion is held against the one that is written out with numpy."""

import numpy as np
import pytest
from support.fusion.slow_motion import UNKNOWN_VARIANCE, slow_motion

from trigpoint.base.clock import NANOSECONDS
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

NOISE = OdometryNoise(0.01, 0.02, 0.03, 0.04, vertical=0.005, tilt=0.006, tilt_turn=0.007)
PERIOD_NS = NANOSECONDS // 20


def drawn(random: np.random.Generator, *, planar: bool) -> OdometryTrack:
    """A robot that drives, stands for a while, and whose odometry has a gap and a jump."""
    track, pose, stamp_ns = OdometryTrack(NOISE, planar=planar), Pose.identity(), 0
    for number in range(60):
        step = random.normal(0.0, [0.02, 0.01, 0.005, 0.03, 0.03, 0.2])
        step[[2, 3, 4]] *= not planar
        step[5] *= number % 7 != 0  # straight on
        still = 30 <= number < 35
        pose = pose if still else pose @ Pose.from_vector(step)
        if number in (40, 50):
            pose = pose @ Pose(np.eye(3), np.array([2.0, 0.0, 0.0]))
        stamp_ns += PERIOD_NS if number != 40 else 40 * PERIOD_NS
        track.add(stamp_ns, pose)
    return track.noisy(NOISE, slip=0.01, skid=0.02)


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("scales", [(0.0, 0.0), (0.03, -0.05)])
def test_motion_is_composed_as_written_out(planar: bool, scales: tuple[float, float]) -> None:
    random = np.random.default_rng(3)
    track = drawn(random, planar=planar)
    some = random.integers(track.first_ns, track.last_ns, 20)
    at_messages = track.stamps_ns[[0, 5, 29, 30, 31, 34, 35, 59]]
    moments = np.sort(np.concatenate([some, at_messages, some[:2]]))
    found = track.motion(moments, np.array(scales))
    expected = slow_motion(track, moments, np.array(scales))
    pose, other = found.earlier_from_later, expected.earlier_from_later
    np.testing.assert_allclose(pose.rotation, other.rotation, rtol=0, atol=1e-13)
    np.testing.assert_allclose(pose.translation, other.translation, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.by_scale, expected.by_scale, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.is_still, expected.is_still)
    unknown = expected.covariance[:, 5, 5] > UNKNOWN_VARIANCE / 2
    for mine, them in ((unknown, 1e-9), (~unknown, 1e-15)):
        assert np.any(mine)
        np.testing.assert_allclose(
            found.covariance[mine], expected.covariance[mine], rtol=1e-11, atol=them
        )
    assert track._gaps[40] > 0
    assert np.flatnonzero(track._jumps).tolist() == [50]
    assert 0 < np.sum(found.is_still) < len(found.is_still)
