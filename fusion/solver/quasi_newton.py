"""Finds the minimum of a smooth function of a few unknowns between bounds."""

from collections.abc import Callable

import numpy as np

from trigpoint.geometry.rotation import Array

Cost = Callable[[Array], tuple[float, Array]]

# A step lowers the value by at least this share of what the gradient promises, and leads to where
# at most that share of the slope is left (Wolfe's conditions).
_LEAST_DECREASE, _MOST_SLOPE = 1e-4, 0.9
_MOST_TRIALS = 20
_LEAST_GRADIENT = 1e-5


def least(
    cost: Cost,
    start: Array,
    *,
    bounds: Array | None = None,
    flat: float = 1e-9,
    most_steps: int = 200,
) -> tuple[Array, float]:
    """Where a function is least near `start` (n,), and its value there.

    `cost`: the value and the gradient (n,); `bounds` (n, 2): within them the first step is as long
    as the gradient, where there are none at most 1; `flat`: the share of the value by which a last
    step lowers it.

    Each step leads along the bounds towards the minimum of a quadratic model in the unknowns that
    no bound holds (Bertsekas, «Projected Newton methods for optimization problems with simple
    constraints», 1982), its Hessian by BFGS (Nocedal and Wright, «Numerical Optimization», 6.1).
    """
    low, high = (-np.inf, np.inf) if bounds is None else bounds.T
    x = np.clip(start, low, high)
    value, gradient = cost(x)
    first = max(1.0, float(np.linalg.norm(gradient))) if bounds is None else 1.0
    hessian, is_first = first * np.eye(len(x)), True
    for _ in range(most_steps):
        free = ~((x <= low) & (gradient > 0) | (x >= high) & (gradient < 0))
        if np.abs(gradient[free]).max(initial=0.0) < _LEAST_GRADIENT:
            break
        step = np.zeros(len(x))
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        length, near, far = 1.0, 0.0, np.inf
        best = x, value, gradient
        for _ in range(_MOST_TRIALS):
            there = np.clip(x + length * step, low, high)
            after, slope = cost(there)
            after = after if np.isfinite(after) else np.inf
            promised = float(gradient @ (there - x))
            moves = (there > low) & (there < high)
            if promised >= 0 or after > value + _LEAST_DECREASE * promised:
                # A parabola through what is known has its minimum there.
                share = promised / (promised - (after - value)) / 2 if promised < 0 else 0.5
                far, length = length, near + (length - near) * min(max(share, 0.1), 0.5)
            elif slope[moves] @ step[moves] < _MOST_SLOPE * (gradient @ step):
                near, length = length, (length + far) / 2 if np.isfinite(far) else 4 * length
                best = there, after, slope
            else:
                break
        else:
            x, value, gradient = best
            break  # rounding leaves nothing to find, or there is no least value
        moved, turned, gain = there - x, slope - gradient, value - after
        x, value, gradient = there, after, slope
        if gain <= flat * max(abs(value + gain), abs(value), 1.0):
            break
        curvature = float(turned @ moved)
        if curvature <= 0:
            continue  # the function bends down here: the model does not
        if is_first:
            hessian, is_first = np.eye(len(x)) * (turned @ turned) / curvature, False
        pull = hessian @ moved
        hessian += np.outer(turned, turned) / curvature - np.outer(pull, pull) / (moved @ pull)
    return x, value
