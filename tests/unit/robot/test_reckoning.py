"""Dead reckoning and its covariance, against sampled ways."""

import numpy as np

from trigpoint.config import OdometryNoise
from trigpoint.geometry import Pose
from trigpoint.robot.odometry import OdometryHistory, Stamped
from trigpoint.robot.reckoning import Belief, Reckoning, advanced, anchored

START = Pose.planar(2.0, -1.0, 0.8)
STEPS = 60
STEP, TURN = 0.05, 0.03


def way(step: float = STEP, turn: float = TURN) -> list[Stamped]:
    """An arc; one reading a step."""
    pose, found = Pose.identity(), [Stamped(0, 0, Pose.identity())]
    for k in range(1, STEPS + 1):
        pose = pose @ Pose.planar(step, 0.0, turn)
        found.append(Stamped(k, k, pose))
    return found


def reckoned(noise: OdometryNoise, covariance: np.ndarray) -> Belief:
    belief = anchored(way()[0], START, covariance, noise)
    for entry in way()[1:]:
        belief = advanced(belief, entry, noise)
    return belief


def test_pose_is_the_start_and_the_way() -> None:
    belief = reckoned(OdometryNoise(), np.zeros((6, 6)))
    np.testing.assert_allclose(
        belief.map_from_base.difference(START @ way()[-1].odom_from_base), 0, atol=1e-12
    )


def test_covariance_is_that_of_sampled_ways() -> None:
    noise = OdometryNoise(
        distance=0.004, lateral=0.002, heading_drive=0.004, heading_turn=0.006,
        distance_scale=0.004, heading_scale=0.006,
    )  # fmt: skip
    belief, random = reckoned(noise, np.zeros((6, 6))), np.random.default_rng(0)
    count = 3000
    scale = 1 + random.standard_normal((2, count)) * [[0.004], [0.006]]
    pose = START @ Pose.planar(np.zeros(count), 0, 0)
    for _ in range(STEPS):
        along = noise.distance * np.sqrt(STEP) * random.standard_normal(count)
        across = noise.lateral * np.sqrt(STEP) * random.standard_normal(count)
        spread = np.sqrt(noise.heading_drive**2 * STEP + noise.heading_turn**2 * TURN)
        turn = TURN * scale[1] + spread * random.standard_normal(count)
        middle = TURN / 2
        x = STEP * scale[0] + np.cos(middle) * along - np.sin(middle) * across
        y = np.sin(middle) * along + np.cos(middle) * across
        pose = pose @ Pose.planar(x, y, turn)
    errors = pose.difference(belief.map_from_base)[:, [0, 1, 5]]
    sampled = errors.T @ errors / count
    expected = belief.pose_covariance[np.ix_([0, 1, 5], [0, 1, 5])]
    ratio = np.linalg.eigvals(np.linalg.solve(expected, sampled)).real
    assert ratio.min() > 0.85
    assert ratio.max() < 1.15


def test_uncertain_heading_spreads_the_place_with_the_distance() -> None:
    covariance = np.zeros((6, 6))
    covariance[5, 5] = 0.01**2
    quiet = OdometryNoise(0, 0, 0, 0)
    belief = reckoned(quiet, covariance)
    arm = belief.map_from_base.translation - START.translation
    place = belief.pose_covariance[:2, :2]
    np.testing.assert_allclose(np.sqrt(np.trace(place)), 0.01 * np.hypot(arm[0], arm[1]))


def test_reckoning_since_an_anchor_in_the_past_goes_over_the_readings_since() -> None:
    history, noise = OdometryHistory(1.0), OdometryNoise()
    for entry in way():
        history.add(entry)
    anchor = anchored(way()[20], START, np.eye(6) * 1e-4, noise)
    found = Reckoning(anchor, history, noise).at(way()[50])
    straight = anchor
    for entry in way()[21:51]:
        straight = advanced(straight, entry, noise)
    np.testing.assert_allclose(found.covariance, straight.covariance, atol=1e-15)
    np.testing.assert_allclose(found.map_from_base.difference(straight.map_from_base), 0, atol=1e-9)


def test_forgetting_keeps_what_later_moments_need() -> None:
    history, noise = OdometryHistory(1.0), OdometryNoise()
    reckoning = Reckoning(anchored(way()[0], START, np.eye(6), noise), history, noise)
    for entry in way()[1:]:
        reckoning.add(entry)
    before = reckoning.at(way()[40])
    reckoning.forget(30)
    assert len(reckoning._beliefs) == STEPS - 30 + 1
    np.testing.assert_allclose(reckoning.at(way()[40]).covariance, before.covariance)
