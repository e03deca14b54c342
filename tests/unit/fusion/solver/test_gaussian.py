"""A Gaussian that is updated by looks at few of its unknowns, against one worked out whole."""

import pickle

import numpy as np
import pytest

from trigpoint.fusion.solver import gaussian
from trigpoint.fusion.solver.gaussian import Gaussian
from trigpoint.geometry.rotation import Array

SIZE, ROBOT, CAMERA = 63, 3, 6
LAST = np.arange(SIZE - ROBOT, SIZE)


class Whole:
    """The same Gaussian by the textbook: every column is touched by every step."""

    def __init__(self, mean: Array, covariance: Array) -> None:
        self.mean, self.covariance = mean.copy(), covariance.copy()

    def move(self, columns: np.ndarray, matrix: Array, shift: Array, noise: Array) -> None:
        step = np.eye(SIZE)
        step[np.ix_(columns, columns)] = matrix
        self.mean = step @ self.mean
        self.mean[columns] += shift
        self.covariance = step @ self.covariance @ step.T
        self.covariance[np.ix_(columns, columns)] += noise

    def update(self, columns: np.ndarray, jacobian: Array, residual: Array) -> float:
        whole = np.zeros((len(jacobian), SIZE))
        whole[:, columns] = jacobian
        innovation = residual + whole @ self.mean
        spread = np.eye(len(jacobian)) + whole @ self.covariance @ whole.T
        gain = self.covariance @ whole.T @ np.linalg.inv(spread)
        self.mean = self.mean - gain @ innovation
        self.covariance = self.covariance - gain @ whole @ self.covariance
        return float(innovation @ np.linalg.solve(spread, innovation))


def columns_of(camera: int) -> np.ndarray:
    return CAMERA * camera + np.arange(CAMERA)


def start(random: np.random.Generator) -> tuple[Array, Array]:
    root = random.normal(size=(SIZE, SIZE)) * np.exp(random.normal(size=SIZE))[:, None]
    return random.normal(size=SIZE), root @ root.T


def driven(random: np.random.Generator, looks: int) -> tuple[Gaussian, Whole]:
    """Both after a drive past cameras in turn, now and then past all of them again."""
    mean, covariance = start(random)
    mine, whole = Gaussian.of(mean, covariance), Whole(mean, covariance)
    for look in range(looks):
        matrix = np.eye(ROBOT) + 0.3 * random.normal(size=(ROBOT, ROBOT))
        shift, noise = random.normal(size=ROBOT), 0.1 * np.eye(ROBOT)
        mine = mine.moved(LAST, LAST, matrix, shift, noise)
        whole.move(LAST, matrix, shift, noise)
        where = np.concatenate([LAST, columns_of(look // 3 % (SIZE // CAMERA))])
        jacobian, residual = random.normal(size=(5, len(where))), random.normal(size=5)
        mine, whitened = mine.updated(where, jacobian, residual)
        assert whitened @ whitened == pytest.approx(whole.update(where, jacobian, residual))
    return mine, whole


def assert_same(mine: Gaussian, whole: Whole) -> None:
    sigma = np.sqrt(np.diagonal(whole.covariance))
    np.testing.assert_allclose((mine.mean - whole.mean) / sigma, 0.0, atol=1e-7)
    apart = (mine.covariance - whole.covariance) / sigma[:, None] / sigma
    np.testing.assert_allclose(apart, 0.0, atol=1e-7)


@pytest.mark.parametrize("most_near", [1, 20, 1000], ids=["at once", "now and then", "never"])
def test_steps_give_what_whole_ones_give(monkeypatch: pytest.MonkeyPatch, most_near: int) -> None:
    """Whenever the far columns are worked out."""
    monkeypatch.setattr(gaussian, "_MOST_NEAR", most_near)
    assert_same(*driven(np.random.default_rng(1), looks=60))


def test_parts_are_those_of_the_whole() -> None:
    mine, whole = driven(np.random.default_rng(2), looks=9)
    near, far = columns_of(1), columns_of(8)
    for columns in (near, far, np.concatenate([far[::-1], LAST, near])):
        sigma = np.sqrt(np.diagonal(whole.covariance))[columns]
        np.testing.assert_allclose(
            (mine.mean_of(columns) - whole.mean[columns]) / sigma, 0.0, atol=1e-9
        )
        expected = whole.covariance[np.ix_(columns, columns)]
        apart = (mine.covariance_of(columns) - expected) / sigma[:, None] / sigma
        np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    groups = np.stack([columns_of(camera) for camera in range(SIZE // CAMERA)])
    for columns, block in zip(groups, mine.blocks(groups), strict=True):
        np.testing.assert_allclose(block, mine.covariance_of(columns), rtol=1e-9, atol=1e-12)


def test_column_may_be_made_from_others() -> None:
    random = np.random.default_rng(3)
    mean, covariance = start(random)
    of, matrix = np.concatenate([LAST, columns_of(2)]), random.normal(size=(ROBOT, 9))
    after = Gaussian.of(mean, covariance).moved(LAST, of, matrix, np.zeros(3), np.zeros((3, 3)))
    step = np.eye(SIZE)
    step[LAST] = 0.0
    step[np.ix_(LAST, of)] = matrix
    np.testing.assert_allclose(after.mean, step @ mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(after.covariance, step @ covariance @ step.T, atol=1e-10)


def test_earlier_one_is_left_as_it_was_and_shares_what_it_came_from() -> None:
    random = np.random.default_rng(4)
    before, _ = driven(random, looks=3)
    expected = before.covariance.copy()
    where = np.concatenate([LAST, columns_of(4)])
    after, _ = before.updated(where, random.normal(size=(5, 9)), random.normal(size=5))
    np.testing.assert_array_equal(before.covariance, expected)
    assert after.before is before.before


def test_settled_one_is_the_same_and_can_be_handed_to_another_process() -> None:
    mine, whole = driven(np.random.default_rng(5), looks=7)
    settled = mine.settled()
    assert settled.settled() is settled
    assert_same(pickle.loads(pickle.dumps(settled)), whole)


def test_it_is_worth_settling_before_a_step_has_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaussian, "_MOST_NEAR", 2 * (ROBOT + CAMERA))
    random = np.random.default_rng(6)
    mine = Gaussian.of(*start(random))
    base, worth = mine.before, []
    for camera in range(2):
        where = np.concatenate([LAST, columns_of(camera)])
        mine, _ = mine.updated(where, random.normal(size=(5, 9)), random.normal(size=5))
        worth.append(mine.is_worth_settling)
        assert mine.before is base
    assert worth == [False, True]
    assert not mine.settled().is_worth_settling


@pytest.mark.parametrize("most_near", [12, 24, 1000])
def test_held_columns_stay_and_what_is_learnt_bears_their_errors(
    monkeypatch: pytest.MonkeyPatch, most_near: int
) -> None:
    """Against the textbook's gain of any update, Joseph's form, with the rows of the held at 0."""
    monkeypatch.setattr(gaussian, "_MOST_NEAR", most_near)
    random = np.random.default_rng(4)
    mean, covariance = start(random)
    mine, held = Gaussian.of(mean.copy(), covariance.copy()), np.arange(SIZE - ROBOT)
    whole = Whole(mean, covariance)
    for look in range(12):
        columns = np.concatenate([LAST, columns_of(look % 5)])
        jacobian, residual = random.normal(size=(7, len(columns))), random.normal(size=7)
        mine, _ = mine.updated(columns, jacobian, residual, free=LAST)
        wide = np.zeros((7, SIZE))
        wide[:, columns] = jacobian
        spread = np.eye(7) + wide @ whole.covariance @ wide.T
        gain = whole.covariance @ wide.T @ np.linalg.inv(spread)
        gain[held] = 0.0
        whole.mean = whole.mean - gain @ (residual + wide @ whole.mean)
        kept = np.eye(SIZE) - gain @ wide
        whole.covariance = kept @ whole.covariance @ kept.T + gain @ gain.T
    assert_same(mine, whole)
    np.testing.assert_array_equal(mine.mean[held], mean[held])
    inner = np.ix_(held, held)
    np.testing.assert_array_equal(mine.covariance[inner], covariance[inner])
