"""Where a visit's search starts: each way to read a sighting is judged by all the others."""

import numpy as np
import pytest

from trigpoint.fusion.association.consensus import Ways, start_costs
from trigpoint.fusion.association.events import Events
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, turned_axes

EVENTS = Events()
PICTURES = 5


def covariances(random: np.random.Generator, count: int, scale: float) -> Array:
    root = np.eye(6) + 0.3 * random.normal(size=(count, 6, 6))
    return scale * root @ np.swapaxes(root, 1, 2)


def poses(random: np.random.Generator, count: int, scale: float) -> Pose:
    return Pose(
        so3.exp(scale * random.normal(size=(count, 3))), scale * random.normal(size=(count, 3))
    )


def drawn(seed: int) -> tuple[Ways, Pose, Array, Array]:
    """Pictures of two sightings, each of which may be read in three ways: as it was but for noise,
    in one of its pictures off by half a metre, and in two other ways."""
    random = np.random.default_rng(seed)
    there, camera = poses(random, PICTURES, 1.0), poses(random, 1, 1.0)[0]
    picture = np.repeat(np.arange(PICTURES), 6)
    right = camera.inverse() @ there
    off = np.where(np.arange(len(picture)) % 3 == 0, 2e-3, 1.0)[:, None]
    shown = right[picture].disturbed(off * random.normal(size=(len(picture), 6)))
    shown.translation[12] += 0.5
    ways = Ways(
        np.repeat(np.arange(2 * PICTURES), 3),
        picture,
        shown,
        covariances(random, len(picture), 4e-6),
        random.uniform(0, 3, len(picture)),
    )
    extra = covariances(random, PICTURES, 1e-6)
    drift = covariances(random, PICTURES**2, 1e-6).reshape(PICTURES, PICTURES, 6, 6)
    return ways, there, extra, drift


def slow_cost(ways: Ways, a: int, b: int, there: Pose, extra: Array, drift: Array) -> float:
    """The cost of taking both of two ways to be right."""
    seed, other = ways.picture[a], ways.picture[b]
    camera = there[seed] @ ways.camera_from_base[a].inverse()
    axes = turned_axes(camera.rotation)
    own = axes @ ways.covariance[a] @ axes.T + extra[seed]
    seen = camera @ ways.camera_from_base[b]
    # The robot in the other picture is fixed to the camera, which is fixed to it in the seed's.
    swing = lever(seen.translation - there[seed].translation)
    spread = swing @ own @ swing.T + axes @ ways.covariance[b] @ axes.T
    spread += extra[other] + drift[seed, other]
    error = seen.difference(there[other])
    room = min(np.linalg.slogdet(spread)[1], EVENTS.pose_score)
    return float(error @ np.linalg.solve(spread, error) + room + ways.excess[b])


@pytest.mark.parametrize("seed", range(3))
def test_costs_are_those_of_the_best_pairs(seed: int) -> None:
    ways, there, extra, drift = drawn(seed)
    seeds = np.array([0, 1, 7, 12, 28])
    found = start_costs(ways, seeds, 2 * PICTURES, there, extra, drift, EVENTS)
    for row, a in zip(found, seeds.tolist(), strict=True):
        for sighting, cost in enumerate(row):
            if sighting == ways.sighting[a]:
                assert cost == 0.0
                continue
            mine = np.flatnonzero(ways.sighting == sighting)
            costs = [slow_cost(ways, a, b, there, extra, drift) for b in mine.tolist()]
            assert cost == pytest.approx(min(*costs, EVENTS.wrong_limit), rel=1e-6)


def test_right_way_agrees_with_all_but_the_wrong_sighting() -> None:
    ways, there, extra, drift = drawn(0)
    cost = start_costs(ways, np.array([0, 12]), 2 * PICTURES, there, extra, drift, EVENTS)
    is_wrong = cost >= EVENTS.wrong_limit
    np.testing.assert_array_equal(is_wrong[0], np.arange(2 * PICTURES) == 4)
    np.testing.assert_array_equal(is_wrong[1], np.arange(2 * PICTURES) != 4)


def test_way_of_no_sighting_is_refused() -> None:
    ways, there, extra, drift = drawn(0)
    with pytest.raises(RuntimeError, match="none"):
        start_costs(ways, np.array([0]), 3, there, extra, drift, EVENTS)
