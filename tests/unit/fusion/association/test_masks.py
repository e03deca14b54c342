"""Wrong sightings that hide each other are found together."""

import numpy as np
import pytest

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.linear import Linear
from trigpoint.fusion.association.masks import likeliest_wrong
from trigpoint.fusion.model.jitter import Jitter

SIGMA = 1e-3
DISPLACED = np.array([0.03, 0.0, 0.02, 0.0, 0.005, 0.0])


def visit(wrong: tuple[int, ...], pictures: int = 10, seed: int = 0) -> Linear:
    """Pictures of a robot that moves in the plane, of which odometry knows each step to 3 cm."""
    random = np.random.default_rng(seed)
    count = 3 * (pictures - 1) + 6
    by_unknowns = np.zeros((pictures, 6, count))
    by_unknowns[:, :, -6:] = np.eye(6)
    by_steps = np.zeros((pictures - 1, 3, count))
    for picture in range(1, pictures):
        nodes = slice(3 * (picture - 1), 3 * picture)
        by_unknowns[picture, [0, 1, 5], nodes] = -np.eye(3)
        by_steps[picture - 1, :, nodes] = np.eye(3)
        if picture > 1:
            by_steps[picture - 1, :, 3 * (picture - 2) : 3 * (picture - 1)] = -np.eye(3)
    shifts = random.normal(scale=SIGMA, size=(pictures, 6))
    for picture in wrong:
        shifts[picture] += DISPLACED
    spread = np.tile(np.diag([9e-4, 9e-4, 1e-4]), (pictures - 1, 1, 1))
    return Linear(
        shifts=shifts,
        own=np.tile(SIGMA**2 * np.eye(6), (pictures, 1, 1)),
        by_unknowns=by_unknowns,
        parts=list(range(pictures)),
        places=np.eye(pictures, 3),
        steps=random.normal(size=(pictures - 1, 3)) * 0.01,
        steps_by_unknowns=by_steps,
        spread=spread,
        by_odometry=spread,
        by_slip=np.zeros_like(spread),
        broken=np.zeros_like(spread),
        prior=np.zeros((count, count)),
        camera=np.arange(count - 6, count),
    )


@pytest.mark.parametrize("wrong", [(), (0,), (9,), (0, 2), (0, 1, 3), (4, 5, 6)])
def test_wrong_sightings_are_found_though_they_agree(wrong: tuple[int, ...]) -> None:
    found = likeliest_wrong(visit(wrong), None, Events())[0]
    assert found == tuple(picture in wrong for picture in range(10))


def test_what_a_mast_sways_by_is_no_wrong_sighting() -> None:
    jitter = Jitter(sway=0.03, tilt=0.03)
    assert not any(likeliest_wrong(visit((0, 2)), jitter, Events())[0])
