"""Cameras of an earlier network widen by what they may have crept since."""

import numpy as np
import pytest
from scipy.special import chdtri

from trigpoint.base.clock import NANOSECONDS
from trigpoint.fusion.model.known_cameras import Creep, KnownCameras
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

DAY_NS = 86_400 * NANOSECONDS
UNTIL_NS = 1_700_000_000 * NANOSECONDS
CREEP = {"c1": Creep(3e-4, 1e-4), "c2": Creep(2e-4, 2e-4)}


def covariance_of(random: np.random.Generator) -> Array:
    """A joint one of two cameras, which errors in common correlate."""
    root = random.normal(0.0, 5e-4, (12, 12))
    return root @ root.T + 1e-8 * np.eye(12)


def poses(random: np.random.Generator) -> dict[str, Pose]:
    drawn = random.normal(size=(2, 6))
    return {f"c{i + 1}": Pose.identity().disturbed(step) for i, step in enumerate(drawn)}


def known(random: np.random.Generator, covariance: Array) -> KnownCameras:
    return KnownCameras(poses(random), np.linalg.inv(covariance), UNTIL_NS, CREEP)


def walked(random: np.random.Generator, camera: str, days: float, *, steps: int = 8) -> Array:
    """How far a camera crept, (6,): steps of a random walk in its own frame."""
    creep = CREEP[camera]
    sigmas = np.repeat([creep.translation, creep.rotation], 3) * np.sqrt(days / steps)
    return np.sum(random.normal(size=(steps, 6)), axis=0) * sigmas


def test_widened_cameras_are_honest_over_drawn_creep_and_days() -> None:
    """NEES over 400 draws of days from an hour to two years."""
    random = np.random.default_rng(11)
    covariance, squares = covariance_of(random), []
    root = np.linalg.cholesky(covariance)
    before = known(random, covariance)
    for _ in range(400):
        days = float(np.exp(random.uniform(np.log(1 / 24), np.log(730.0))))
        drawn = root @ random.normal(size=12)
        apart = []
        for row, (name, pose) in enumerate(before.poses.items()):
            # Its error when the network was made, then a walk about its own axes.
            there = pose.disturbed(drawn[6 * row : 6 * row + 6])
            walk = walked(random, name, days)
            crept = np.concatenate([there.rotation @ walk[:3], there.rotation @ walk[3:]])
            apart.append(there.disturbed(crept).difference(pose))
        now = before.at(UNTIL_NS + round(days * DAY_NS))
        error = np.concatenate(apart)
        squares.append(float(error @ now.information @ error))
    low, high = chdtri(12 * len(squares), [1 - 1e-4, 1e-4]) / len(squares)
    assert low < np.mean(squares) < high


def test_creep_is_each_cameras_own() -> None:
    random = np.random.default_rng(3)
    covariance = covariance_of(random)
    wider = known(random, covariance).at(UNTIL_NS + 100 * DAY_NS).covariance - covariance
    expected = np.repeat([3e-3, 1e-3, 2e-3, 2e-3], 3) ** 2
    np.testing.assert_allclose(wider, np.diag(expected), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("until_ns", [None, UNTIL_NS])
def test_without_a_time_or_before_it_nothing_widens(until_ns: int | None) -> None:
    random = np.random.default_rng(3)
    before = known(random, covariance_of(random))
    then = KnownCameras(before.poses, before.information, until_ns, CREEP)
    stamp_ns = UNTIL_NS - DAY_NS if until_ns else UNTIL_NS + 100 * DAY_NS
    assert then.at(stamp_ns) is then


def test_widening_in_two_steps_is_that_in_one() -> None:
    random = np.random.default_rng(5)
    before = known(random, covariance_of(random))
    once = before.at(UNTIL_NS + 9 * DAY_NS)
    twice = before.at(UNTIL_NS + 4 * DAY_NS).at(UNTIL_NS + 9 * DAY_NS)
    np.testing.assert_allclose(twice.covariance, once.covariance, rtol=1e-9, atol=1e-15)


def test_what_is_put_beside_is_independent_and_may_be_taken_out_again() -> None:
    random = np.random.default_rng(4)
    cameras, one = poses(random), Pose.stack([Pose.identity()])

    def drawn(faces: dict[str, Pose], values: dict[tuple[str, str], Array]) -> KnownCameras:
        eyes = cameras if values and ("lens", "c1") in values else {}
        size = 6 * (len(eyes) + len(faces)) + sum(len(value) for value in values.values())
        root = np.eye(size) + 0.2 * random.normal(size=(size, size))
        return KnownCameras(eyes, root @ root.T, UNTIL_NS, CREEP, faces, values)

    mine = drawn({"r1": one}, {("lens", "c1"): np.ones(9), ("scales", "r1"): np.zeros(2)})
    other = drawn({"r2": one}, {("scales", "r2"): np.ones(2)})
    both = mine.beside(other)
    assert (list(both.faces), list(both.values)) == (["r1", "r2"], [*mine.values, *other.values])
    for part, gone in ((mine, "r2"), (other, "")):
        left = both.without(lambda _, name, gone=gone: name == gone if gone else name != "r2")
        np.testing.assert_allclose(left.covariance, part.covariance, rtol=1e-9, atol=1e-12)
