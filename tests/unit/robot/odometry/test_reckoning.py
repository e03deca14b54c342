"""Dead reckoning and its covariance, against sampled ways."""

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.robot.odometry.odometry import Stamped
from trigpoint.robot.odometry.recent import OdometryHistory
from trigpoint.robot.odometry.reckoning import carried, pose_covariances, started, steps_along
from trigpoint.site.config import OdometryNoise

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


def end() -> Pose:
    return START @ way()[-1].odom_from_base


def reckoned(noise: OdometryNoise, covariance: np.ndarray) -> np.ndarray:
    """The contract's (6, 6) at the end of the way."""
    steps = steps_along(Pose.stack([entry.odom_from_base for entry in way()]), noise)
    return pose_covariances(end(), carried(started(START, covariance, noise), steps))


def test_covariance_is_that_of_sampled_ways() -> None:
    noise = OdometryNoise(
        distance=0.004, lateral=0.002, heading_drive=0.004, heading_turn=0.006,
        distance_scale=0.004, heading_scale=0.006,
    )  # fmt: skip
    found, random = reckoned(noise, np.zeros((6, 6))), np.random.default_rng(0)
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
    errors = pose.difference(end())[:, [0, 1, 5]]
    sampled = errors.T @ errors / count
    expected = found[np.ix_([0, 1, 5], [0, 1, 5])]
    ratio = np.linalg.eigvals(np.linalg.solve(expected, sampled)).real
    assert ratio.min() > 0.85
    assert ratio.max() < 1.15


def test_uncertain_heading_spreads_the_place_with_the_distance() -> None:
    covariance = np.zeros((6, 6))
    covariance[5, 5] = 0.01**2
    arm = end().translation - START.translation
    place = reckoned(OdometryNoise(0, 0, 0, 0), covariance)[:2, :2]
    np.testing.assert_allclose(np.sqrt(np.trace(place)), 0.01 * np.hypot(arm[0], arm[1]))


def test_ways_of_the_history_are_the_steps_between_its_readings() -> None:
    noise = OdometryNoise()
    history = OdometryHistory(1.0, noise)
    for entry in way():
        history.add(entry)
    begin, finish = way()[20], way()[50]
    straight = started(START, np.eye(6) * 1e-4, noise)
    found = carried(straight, history.steps(begin, finish))
    for before, after in zip(way()[20:50], way()[21:51], strict=True):
        both = Pose.stack([before.odom_from_base, after.odom_from_base])
        straight = carried(straight, steps_along(both, noise))
    np.testing.assert_allclose(found, straight, atol=1e-15)


def test_many_places_are_carried_on_together() -> None:
    noise = OdometryNoise(distance_scale=0.01)
    way = Pose.stack([Pose.identity(), Pose.planar(0.1, 0.02, 0.3)])
    (step,) = steps_along(way, noise)
    one = started(START, np.eye(6) * 1e-4, noise)
    two = started(Pose.identity(), np.eye(6) * 1e-2, noise)
    both = carried(np.stack([one, two]), [step])
    np.testing.assert_allclose(both, [carried(one, [step]), carried(two, [step])], atol=1e-18)
