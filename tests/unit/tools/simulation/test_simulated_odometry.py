"""The odometry that a simulated robot reports, held against the contract's noise model."""

import numpy as np
import pytest

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import wrap
from trigpoint.site.config import OdometryNoise
from trigpoint.tools.simulation.motion.odometry import chained, drawn_scales, increments, reported
from trigpoint.tools.simulation.world import load_world

NOISE = OdometryNoise(distance=0.006, lateral=0.002, heading_drive=0.004, heading_turn=0.006)
SEEDS = 40


def true_increments() -> np.ndarray:
    world = load_world("lab", seed=0)
    return increments(world.map_from_base("r1", np.arange(0, world.duration_s, 0.02)))


def whitened(truth: np.ndarray, report: np.ndarray, noise: OdometryNoise) -> np.ndarray:
    """Noise of each moving increment over the contract's sigma, with L and H as reported."""
    length, turn = np.hypot(report[:, 0], report[:, 1]), np.abs(report[:, 2])
    error = truth - report
    cosine, sine = np.cos(report[:, 2] / 2), np.sin(report[:, 2] / 2)
    along = cosine * error[:, 0] + sine * error[:, 1]
    across = -sine * error[:, 0] + cosine * error[:, 1]
    heading = np.sqrt(noise.heading_drive**2 * length + noise.heading_turn**2 * turn)
    moving = length > 1e-9
    return np.column_stack(
        [
            along[moving] / (noise.distance * np.sqrt(length[moving])),
            across[moving] / (noise.lateral * np.sqrt(length[moving])),
            error[moving, 2] / heading[moving],
        ]
    )


def plainly_reported(truth: np.ndarray, seed: int) -> np.ndarray:
    return reported(truth, NOISE, np.zeros(2), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def draws() -> np.ndarray:
    """(seeds, increments, 3), each in its sigma."""
    truth = true_increments()
    reports = [plainly_reported(truth, seed) for seed in range(SEEDS)]
    return np.array([whitened(truth, report, NOISE) for report in reports])


def test_every_component_has_the_contracts_variance(draws: np.ndarray) -> None:
    count = draws.shape[0] * draws.shape[1]
    # Five sigma of a mean square of `count` normal draws, and the percent or so by which L and H of
    # a report differ from their means.
    tolerance = 5 * np.sqrt(2 / count) + 0.03
    assert np.all(np.abs((draws**2).mean(axis=(0, 1)) - 1) < tolerance)


def test_noise_has_no_mean(draws: np.ndarray) -> None:
    count = draws.shape[0] * draws.shape[1]
    # Weighting by the report's own length shifts it by half the relative noise of a step, 4 %.
    assert np.all(np.abs(draws.mean(axis=(0, 1))) < 5 / np.sqrt(count) + [0.05, 0.01, 0.01])


def test_increments_and_their_components_are_independent(draws: np.ndarray) -> None:
    limit = 5 / np.sqrt(draws.shape[0] * draws.shape[1])
    following = (draws[:, 1:] * draws[:, :-1]).mean(axis=(0, 1))
    between = [(draws[..., i] * draws[..., j]).mean() for i, j in [(0, 1), (0, 2), (1, 2)]]
    assert np.all(np.abs([*following, *between]) < limit + 0.005)


def test_the_whole_way_is_off_by_what_the_model_says_and_not_to_one_side() -> None:
    truth = true_increments()
    sums = np.array(
        [(truth - plainly_reported(truth, seed)).sum(axis=0)[2]
         for seed in range(200)]
    )  # fmt: skip
    length, turn = np.hypot(truth[:, 0], truth[:, 1]).sum(), np.abs(truth[:, 2]).sum()
    sigma = np.sqrt(NOISE.heading_drive**2 * length + NOISE.heading_turn**2 * turn)
    chi2 = float(((sums / sigma) ** 2).sum())
    assert abs(sums.mean()) < 4.5 * sigma / np.sqrt(len(sums))
    assert 200 - 5 * np.sqrt(400) < chi2 < 200 + 5 * np.sqrt(400)


def test_scale_errors_multiply_the_report() -> None:
    noise = OdometryNoise(0, 0, 0, 0, distance_scale=0.1, heading_scale=0.2)
    truth = true_increments()
    scale_errors = drawn_scales(noise, np.random.default_rng(5))
    report = reported(truth, noise, scale_errors, np.random.default_rng(6))
    moving = np.abs(truth) > 1e-6
    ratio = np.where(moving, truth / np.where(moving, report, 1.0), np.nan)
    expected = 1 + np.random.default_rng(5).standard_normal(2) * [0.1, 0.2]
    assert np.nanmax(np.abs(ratio[:, 0] - expected[0])) < 1e-9
    assert np.nanmax(np.abs(ratio[:, 2] - expected[1])) < 1e-9


def test_a_standing_robot_reports_no_motion() -> None:
    report = reported(np.zeros((50, 3)), NOISE, np.zeros(2), np.random.default_rng(0))
    assert np.all(report == 0)


def test_increments_and_chained_are_inverse() -> None:
    random = np.random.default_rng(1)
    steps = random.normal(0, 0.3, (30, 3))
    poses = chained(Pose.planar(1.0, -2.0, 3.0), steps)
    again = increments(poses)
    assert np.allclose(again[:, :2], steps[:, :2])
    assert np.allclose(wrap(again[:, 2] - steps[:, 2]), 0)


def test_the_logs_noise_is_the_worlds_own() -> None:
    world = load_world("lab", seed=4)
    log = world.odometry("r1")
    truth = increments(world.map_from_base("r1", log.stamps_s))
    error = whitened(truth, increments(log.poses), world.robots["r1"].noise)
    assert np.all(np.abs((error**2).mean(axis=0) - 1) < 0.2)
