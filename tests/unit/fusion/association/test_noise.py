"""Noise is learnt where a session tells, and stays as stated where it does not."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.linear_visits import simple_visit

from trigpoint.fusion.association.budget import Budget
from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.linear import Linear
from trigpoint.fusion.association.noise import STATED, Noise
from trigpoint.fusion.association.variances import corner_scale, expected_slope, learn

SLOPE = Events().priors.floor_tilt


def visit(seed: int, noise: Noise, pictures: int = 12, at_a_stop: int = 1) -> Linear:
    """A visit to a camera of a robot that is moved in space: pictures of 2 mm and 1 mrad, odometry
    of 5 mm and 5 mrad a step, with the noise; so many `pictures` are taken `at_a_stop`, and the
    stops are half a metre apart."""
    random = np.random.default_rng(seed)
    own = np.diag([4e-6, 4e-6, 4e-6, 1e-6, 1e-6, 1e-6])
    jitter = np.zeros(6) if noise.jitter is None else noise.jitter.variances
    step = np.diag([25e-6, 25e-6, 25e-6])
    slip = np.diag([1e-6, 1e-6, 1e-12])
    spread = np.sqrt(np.diagonal(own) + jitter)
    walk = np.sqrt(noise.odometry**2 * np.diagonal(step) + noise.slip**2 * np.diagonal(slip))
    shifts = random.normal(size=(pictures, 6)) * spread
    places = np.zeros((pictures, 3))
    places[:, 0] = 0.5 * (np.arange(pictures) // at_a_stop)
    if noise.length > 0:
        scatter = random.normal(size=(pictures, 2)) * np.sqrt(np.diagonal(own)[3:5])
        alike = np.exp(-np.abs(places[:, :1] - places[:, 0]) / noise.length)
        floor = np.linalg.cholesky(alike + 1e-9 * np.eye(pictures)) @ random.normal(
            size=(pictures, 2)
        )
        shifts[:, 3:5] = scatter + noise.tilt * floor
    steps = random.normal(size=(pictures - 1, 3)) * walk
    return simple_visit(shifts, own, steps, step, slip, places)


def test_noise_as_stated_stays_as_stated() -> None:
    changed = 0
    for seed in range(6):
        (found,) = learn([visit(10 * seed + n, Noise()) for n in range(6)], Events())
        assert found is not None
        changed += found != STATED
    assert changed <= 1  # one session in a hundred thinks otherwise


def test_tilt_and_odometry_are_learnt() -> None:
    true = Noise(tilt=math.radians(0.3), sway=3e-3, odometry=2.0)
    (found,) = learn([visit(seed, true) for seed in range(8)], Events())
    assert found is not None
    assert found.tilt == pytest.approx(true.tilt, rel=0.3)
    assert found.odometry == pytest.approx(true.odometry, rel=0.35)


def test_robot_in_space_keeps_its_stated_noise_where_nothing_clearly_tells_otherwise() -> None:
    assert learn([visit(n, Noise()) for n in range(6)], Events(), planar=False) == (None,)
    true = Noise(odometry=4.0)
    (found,) = learn([visit(seed, true) for seed in range(8)], Events(), planar=False)
    assert found is not None
    assert found.odometry == pytest.approx(true.odometry, rel=0.35)


@pytest.mark.parametrize("planar", [True, False])
def test_what_happened_in_one_visit_is_no_noise_of_all(planar: bool) -> None:
    """A camera was moved by half a metre in the middle of one visit."""
    visits = [visit(seed, Noise()) for seed in range(6)]
    steps = visits[2].steps.copy()
    steps[5, 0] += 0.5
    moved = [*visits[:2], replace(visits[2], steps=steps), *visits[3:]]
    first, plain = learn(moved, Events(), planar=planar)
    assert (first,) == learn(visits, Events(), planar=planar)
    assert plain is not None  # what it were, had nothing happened
    assert max(plain.odometry, plain.slip) > 3.0


def test_odometry_that_jumps_in_every_visit_is_noisy() -> None:
    visits = []
    for seed in range(6):
        calm = visit(seed, Noise())
        steps = calm.steps.copy()
        steps[5, 0] += 0.1
        visits.append(replace(calm, steps=steps))
    (found,) = learn(visits, Events())
    assert found is not None
    assert max(found.odometry, found.slip) > 3.0


def test_floor_is_as_by_its_prior_where_every_camera_saw_one_place() -> None:
    visits = [visit(seed, Noise(), at_a_stop=12) for seed in range(6)]
    assert expected_slope(visits, SLOPE, Budget()) == pytest.approx(SLOPE, rel=0.06)
    assert expected_slope(visits, 0.0, Budget()) == 0.0
    (found,) = learn(visits, Events())
    assert found is not None
    assert found.tilt == pytest.approx(SLOPE, rel=0.06)


@pytest.mark.parametrize("degrees", [0.1, 0.3])
def test_slope_that_pictures_tell_is_expected(degrees: float) -> None:
    true = Noise(tilt=math.radians(degrees), length=1.0)
    visits = [visit(seed, true) for seed in range(6)]
    assert expected_slope(visits, SLOPE, Budget()) == pytest.approx(true.tilt, rel=0.4)


def test_few_pictures_tell_nothing() -> None:
    assert learn([visit(1, Noise(), pictures=2)], Events()) == (None,)


def test_corner_scale_leaves_what_is_no_board_out() -> None:
    assert corner_scale([3.9, 4.0, 4.1, 4.0, 900.0]) == pytest.approx(2.0, rel=0.06)
    assert corner_scale([0.8, 0.9, 0.95, 0.9]) == 1.0  # so few may scatter so by chance
    assert corner_scale([]) == 1.0


@pytest.mark.parametrize("length", [0.0, 0.2, 1.0])
def test_how_far_a_slope_reaches_is_learnt(length: float) -> None:
    """A mast that rocks tilts in every picture, a floor from place to place."""
    true = Noise(tilt=math.radians(0.3), sway=3e-3, length=length)
    (found,) = learn([visit(seed, true, pictures=24, at_a_stop=2) for seed in range(8)], Events())
    assert found is not None
    assert found.length == pytest.approx(length, rel=0.5)
    assert found.tilt == pytest.approx(true.tilt, rel=0.3)
