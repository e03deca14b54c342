"""One motion applied to a robot's pose, held to the motion and to its term in a cost."""

import numpy as np
import pytest

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.motion import odometry_step
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.prediction import odometry_terms
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

PERIOD_NS = to_ns(0.05)
BETWEEN_NS = np.array([round(2.3 * PERIOD_NS), round(7.4 * PERIOD_NS)])
SCALES = np.array([0.02, -0.03])
START = Pose.from_vector(np.array([0.0, 0.0, 0.8, 3.0, -2.0, 0.0]))


def winding(*, planar: bool) -> OdometryTrack:
    """Odometry of nine messages with steps of a few centimetres and degrees."""
    noise = OdometryNoise(vertical=0.003, tilt=0.002, tilt_turn=0.004)
    track, pose = OdometryTrack(noise, planar=planar, slip=0.0), Pose.identity()
    random = np.random.default_rng(3)
    for number in range(9):
        track.add(number * PERIOD_NS, pose)
        step = random.normal([0.02, 0, 0, 0, 0, 0], [0.01, 0.004, 0.004, 0.02, 0.02, 0.05])
        if planar:
            step[2:5] = 0.0
        pose = pose @ Pose.from_vector(step)
    return track


@pytest.mark.parametrize("planar", [True, False])
def test_pose_is_carried_on_by_the_motion_and_its_covariance(planar: bool) -> None:
    track = winding(planar=planar)
    motion = track.motion(BETWEEN_NS, SCALES)
    covariance = np.diag([1e-4, 2e-4, 3e-4, 1e-5, 2e-5, 4e-5])
    step = odometry_step(START, motion)
    expected = step.by_start @ covariance @ step.by_start.T
    expected += step.by_motion @ motion.covariance[0] @ step.by_motion.T
    first_ns, last_ns = BETWEEN_NS.tolist()
    end, spread = track.carried_on(first_ns, last_ns, SCALES, START, covariance)
    np.testing.assert_allclose(end.difference(step.end), 0.0, atol=1e-12)
    np.testing.assert_allclose(spread, expected, rtol=0, atol=1e-18)


@pytest.mark.parametrize("planar", [True, False])
def test_step_is_what_the_term_of_odometry_says_of_its_end(planar: bool) -> None:
    track = winding(planar=planar)
    motion, tangent = track.motion(BETWEEN_NS, SCALES), track.tangent
    off = np.zeros(6)
    off[tangent] = 1e-3 * np.arange(1, len(tangent) + 1)
    guess = odometry_step(START, motion).end.disturbed(off)
    first_ns, last_ns = BETWEEN_NS.tolist()
    matrix, shift, noise = track.step(first_ns, last_ns, SCALES, START, guess)
    terms = odometry_terms(Pose.stack([START]), Pose.stack([guess]), motion, tangent)
    by_later = terms.by_later[0]
    np.testing.assert_allclose(by_later @ noise @ by_later.T, np.eye(len(tangent)), atol=1e-9)
    by_start = np.concatenate([terms.by_earlier[0], terms.by_scale[0]], axis=1)
    np.testing.assert_allclose(by_later @ matrix, -by_start, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(by_later @ shift, -terms.residual[0], rtol=1e-9, atol=1e-9)
    # Shifting the end back by what it is off is what odometry alone says of it.
    assert np.abs(shift + off[tangent]).max() < 1e-4 * np.abs(off).max() + 1e-5
