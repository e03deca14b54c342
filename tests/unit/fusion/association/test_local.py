"""Wrong sightings that hide each other are found together."""

import numpy as np
import pytest
from support.fusion.linear_visits import drawn_visit, simple_visit, slow_likeliest_wrong

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.linear import Linear
from trigpoint.fusion.association.local import likeliest_wrong
from trigpoint.fusion.model.jitter import Jitter

SIGMA = 1e-3
DISPLACED = np.array([0.03, 0.0, 0.02, 0.0, 0.005, 0.0])


def visit(wrong: tuple[int, ...], pictures: int = 10, seed: int = 0) -> Linear:
    """Pictures of a robot that moves in the plane, of which odometry knows each step to 3 cm."""
    random = np.random.default_rng(seed)
    shifts = random.normal(scale=SIGMA, size=(pictures, 6))
    for picture in wrong:
        shifts[picture] += DISPLACED
    steps = random.normal(size=(pictures - 1, 3)) * 0.01
    own, spread = SIGMA**2 * np.eye(6), np.diag([9e-4, 9e-4, 1e-4])
    return simple_visit(shifts, own, steps, spread, np.zeros((3, 3)), np.eye(pictures, 3))


@pytest.mark.parametrize("wrong", [(), (0,), (9,), (0, 2), (0, 1, 3), (4, 5, 6)])
def test_wrong_sightings_are_found_though_they_agree(wrong: tuple[int, ...]) -> None:
    found = likeliest_wrong(visit(wrong), None, Events())[0]
    assert found == tuple(picture in wrong for picture in range(10))


def test_what_a_mast_sways_by_is_no_wrong_sighting() -> None:
    jitter = Jitter(sway=0.03, tilt=0.03)
    assert not any(likeliest_wrong(visit((0, 2)), jitter, Events())[0])


@pytest.mark.parametrize("d", [3, 6])
@pytest.mark.parametrize("seed", range(4))
def test_likeliest_sets_are_those_of_all_that_there_are(d: int, seed: int) -> None:
    linear = drawn_visit(seed, d, parts=6)
    linear.shifts[seed] += 0.05
    jitter = Jitter(sway=1e-3, tilt=1e-3)
    found = likeliest_wrong(linear, jitter, Events())
    assert found == slow_likeliest_wrong(linear, jitter.variances, Events())[: len(found)]
