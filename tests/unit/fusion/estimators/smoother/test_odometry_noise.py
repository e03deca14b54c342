"""The noise that an odometry has, from differences drawn with it and from whole drives."""

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    RobotPlan,
    Session,
    circle,
    lab_cameras,
    lab_plan,
    make_session,
    offline,
)

from trigpoint.fusion.estimators.smoother.odometry_noise import Windows, likeliest
from trigpoint.site.config import OdometryNoise
from trigpoint.tools.simulation.sight.targets import target_of

STATED = np.array([0.05, 0.01, 0.003, 0.1, 0.001, 0.001])


def windows(
    sigmas: np.ndarray, count: int = 60, seed: int = 1, *, seen_to: float = 1e-3
) -> Windows:
    """Stretches of up to 0.3 m and 1.5 rad with noise of these sigmas, seen to a millimetre."""
    random = np.random.default_rng(seed)
    length, turned = random.uniform(0.0, 0.3, count), random.uniform(0.0, 1.5, count)
    length[::3], turned[1::3] = 0.0, 0.0  # some only turn, some only drive
    by_noise = np.zeros((6, count, 3, 3))
    for part, (axis, reach) in enumerate([(0, length), (1, length), (2, length), (2, turned)]):
        by_noise[part, :, axis, axis] = reach
    by_noise[4, :, [0, 1], [0, 1]] = turned
    by_noise[5, :, 0, 0] = turned
    by_pictures = np.broadcast_to(seen_to**2 * np.eye(3), (count, 3, 3))
    covariance = by_pictures + np.einsum("k,knij->nij", sigmas**2, by_noise)
    drawn = random.standard_normal((count, 3, 1))
    return Windows((np.linalg.cholesky(covariance) @ drawn)[..., 0], by_pictures, by_noise)


def test_gradient_is_that_of_finite_differences() -> None:
    found, logs, step = windows(STATED), np.log(STATED), 1e-6
    _, gradient = found.misfit(logs)
    numeric = [
        (found.misfit(logs + move)[0] - found.misfit(logs - move)[0]) / (2 * step)
        for move in step * np.eye(6)
    ]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_noise_as_stated_stays_as_stated(seed: int) -> None:
    assert likeliest(windows(STATED, seed=seed), STATED) is STATED


@pytest.mark.parametrize("seed", range(8))
def test_slip_of_less_than_the_least_is_as_stated_too(seed: int) -> None:
    """It was compared with a millimetre of slip and of skid, which any other noise is likelier
    than."""
    quiet = np.array([0.003, 0.001, 0.002, 0.003, 1e-4, 0.0])
    assert likeliest(windows(quiet, seed=seed, seen_to=1e-4), quiet) is quiet


@pytest.mark.parametrize("seed", range(4))
def test_noise_other_than_stated_is_found(seed: int) -> None:
    true = np.array([0.07, 0.003, 0.06, 0.15, 0.01, 0.04])
    found = likeliest(windows(true, count=400, seed=seed), STATED)
    np.testing.assert_allclose(found, true, rtol=0.3)


def test_what_the_windows_do_not_show_stays_near_the_stated() -> None:
    shown = windows(np.array([0.2, 0.01, 0.003, 0.1, 0.001, 0.001]))
    hidden = shown.by_noise.copy()
    hidden[1] = 0.0  # as if nothing lateral were seen
    found = likeliest(Windows(shown.difference, shown.by_pictures, hidden), STATED)
    assert found[0] == pytest.approx(0.2, rel=0.3)
    assert found[1] == pytest.approx(STATED[1], rel=1e-3)


LOUD = OdometryNoise(distance=0.03, lateral=0.01, heading_drive=0.02, heading_turn=0.03)


def told_less(session: Session, noise: OdometryNoise) -> Session:
    """The same drive, of whose odometry the site file states another noise."""
    site = session.inputs.site
    robots = {"r1": msgspec.structs.replace(site.robots["r1"], odometry=noise)}
    site = msgspec.structs.replace(site, robots=robots)
    return replace(session, inputs=replace(session.inputs, site=site))


def loud_drive() -> Session:
    """Four rounds past six cameras at walking pace, with five times the usual noise."""
    robot = RobotPlan(circle(speed=0.2), target_of("charuco"), noise=LOUD)
    plan = lab_plan(cameras=lab_cameras(6), robots={"r1": robot}, seconds=160.0, picture_rate=1.0)
    return make_session(plan)


def test_a_robot_noisier_than_stated_does_not_make_the_network_overconfident() -> None:
    scales_unknown = OdometryNoise(distance_scale=0.05, heading_scale=0.05)
    drive = told_less(loud_drive(), scales_unknown)
    nees = drive.error(offline(drive)).nees
    assert nees is not None
    assert 0.4 < nees < 2.0
