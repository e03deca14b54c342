"""Minima of a few unknowns, held to scipy's L-BFGS-B and to what is known of them."""

import numpy as np
import pytest
from scipy.optimize import minimize

from trigpoint.fusion.solver.quasi_newton import Cost, least
from trigpoint.geometry.rotation import Array


def valley(x: Array) -> tuple[float, Array]:
    """Rosenbrock's: least, 0, at 1."""
    bend, ahead = x[1:] - x[:-1] ** 2, 1 - x[:-1]
    gradient = np.zeros(len(x))
    gradient[1:] += 200 * bend
    gradient[:-1] -= 400 * x[:-1] * bend + 2 * ahead
    return float(np.sum(100 * bend**2 + ahead**2)), gradient


def variances(seed: int, parts: int) -> Cost:
    """-2 ln of the likelihood of variance components by their logarithms, with a prior: as the
    noise of odometry and pictures is learnt."""
    random = np.random.default_rng(seed)
    loads = random.gamma(0.5, 1.0, (40, parts))
    drawn = random.normal(size=40) ** 2 * (loads @ random.gamma(1.0, 1.0, parts) + 0.1)

    def cost(logs: Array) -> tuple[float, Array]:
        own = loads * np.exp(2 * logs)
        variance = own.sum(axis=1) + 0.1
        value = np.sum(drawn / variance + np.log(variance)) + logs @ logs / 4
        by_variance = 1 / variance - drawn / variance**2
        return float(value), 2 * by_variance @ own + logs / 2

    return cost


@pytest.mark.parametrize("unknowns", [2, 4, 6])
def test_the_end_of_a_bent_valley_is_found(unknowns: int) -> None:
    found, value = least(valley, np.full(unknowns, -0.8), flat=1e-14)
    assert value < 1e-9
    assert found == pytest.approx(np.ones(unknowns), abs=1e-4)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("parts", [2, 3, 6])
@pytest.mark.parametrize("is_bounded", [False, True])
def test_it_is_no_worse_than_the_reference(seed: int, parts: int, *, is_bounded: bool) -> None:
    cost, start = variances(seed, parts), np.full(parts, 0.5)
    bounds = np.tile([-1.0, 0.6], (parts, 1)) if is_bounded else None
    reference = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-10}
    )
    found, value = least(cost, start, bounds=bounds, flat=1e-10)
    assert value == cost(found)[0]
    assert value == pytest.approx(float(reference.fun), rel=1e-8)
    assert found == pytest.approx(reference.x, abs=2e-3)
    if bounds is not None:
        assert np.all((found >= -1.0) & (found <= 0.6))


def test_bounds_hold_what_would_leave_them_and_free_what_comes_back() -> None:
    """The second unknown is pushed onto its bound by the first step and wants off it later."""
    bounds = np.array([[-5.0, 0.5], [-0.1, 5.0]])
    found, value = least(valley, np.array([-1.2, 2.0]), bounds=bounds, flat=1e-14)
    assert found == pytest.approx([0.5, 0.25], abs=1e-5)
    assert value == pytest.approx(0.25, rel=1e-6)


def test_a_start_outside_of_the_bounds_is_brought_onto_them() -> None:
    found, value = least(
        lambda x: (float(x @ x), 2 * x), np.array([9.0]), bounds=np.array([[2, 3]])
    )
    assert (found.tolist(), value) == ([2.0], 4.0)


def test_a_minimum_is_left_as_it_is() -> None:
    calls = []

    def cost(x: Array) -> tuple[float, Array]:
        calls.append(x)
        return float(x @ x), 2 * x

    assert least(cost, np.zeros(3))[1] == 0.0
    assert len(calls) == 1


def test_a_value_with_rounding_errors_ends_the_search() -> None:
    random = np.random.default_rng(5)
    count = 0

    def cost(x: Array) -> tuple[float, Array]:
        nonlocal count
        count += 1
        return 4000 + float(x @ x) + 1e-6 * random.normal(), 2 * x

    found, _ = least(cost, np.array([3.0, -2.0]), flat=1e-12)
    assert np.abs(found).max() < 1e-2
    assert count < 100
