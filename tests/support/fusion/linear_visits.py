"""Visits as linear equations, and slow references for what is made of them."""

from itertools import product

import numpy as np

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.linear import Linear
from trigpoint.fusion.association.noise import Noise
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.geometry.rotation import Array


def simple_visit(
    shifts: Array, own: Array, steps: Array, by_odometry: Array, by_slip: Array, places: Array
) -> Linear:
    """A visit of one part a picture, all of which relate the robot to the camera as they stand.

    `shifts` (n, 6), `own` (6, 6) of each; `steps` (n - 1, d), `by_odometry`, `by_slip` (d, d) of
    each; `places` (n, 3).
    """
    n, (m, d) = len(shifts), steps.shape
    free = PLANAR if d == len(PLANAR) else SPATIAL
    nodes = np.arange(n)
    still = np.zeros((m, d, d))
    return Linear(
        shifts=shifts,
        own=np.tile(own, (n, 1, 1)),
        nodes=nodes,
        by_robot=np.tile(np.eye(6)[:, free], (n, 1, 1)),
        by_others=np.tile(-np.eye(6), (n, 1, 1)),
        parts=nodes.tolist(),
        places=places,
        steps=steps,
        by_earlier=still - np.eye(d),
        by_later=still + np.eye(d),
        steps_by_others=np.zeros((m, d, 6)),
        spread=np.tile(by_odometry + by_slip, (m, 1, 1)),
        by_odometry=np.tile(by_odometry, (m, 1, 1)),
        by_slip=np.tile(by_slip, (m, 1, 1)),
        broken=still,
        prior=np.zeros(6),
    )


def drawn_visit(seed: int, d: int, *, parts: int = 7, steps: int = 4, others: int = 9) -> Linear:
    """A visit with arbitrary equations: some nodes have several parts and others none."""
    random = np.random.default_rng(seed)

    def near(shape: tuple[int, ...], middle: Array | float, share: float) -> Array:
        return middle + share * random.normal(size=shape)

    def covariances(count: int, size: int, scale: float) -> Array:
        root = near((count, size, size), np.eye(size), 0.3)
        return scale * root @ np.swapaxes(root, 1, 2)

    free = PLANAR if d == len(PLANAR) else SPATIAL
    by_odometry, by_slip = covariances(steps, d, 4e-6), covariances(steps, d, 1e-6)
    return Linear(
        shifts=1e-3 * random.normal(size=(parts, 6)),
        own=covariances(parts, 6, 1e-6),
        nodes=np.sort(random.integers(0, steps + 1, parts)),
        by_robot=near((parts, 6, d), np.eye(6)[:, free], 0.2),
        by_others=near((parts, 6, others), -np.eye(6, others), 0.2),
        parts=list(range(parts)),
        places=np.round(random.uniform(0, 2, (parts, 3)), 1) * [1, 1, 0],
        steps=2e-3 * random.normal(size=(steps, d)),
        by_earlier=near((steps, d, d), -np.eye(d), 0.2),
        by_later=near((steps, d, d), np.eye(d), 0.2),
        steps_by_others=near((steps, d, others), 0.0, 0.1) * (np.arange(others) >= 6),
        spread=by_odometry + by_slip,
        by_odometry=by_odometry,
        by_slip=by_slip,
        broken=np.zeros((steps, d, d)),
        prior=np.where(np.arange(others) < 6, 0.0, 1e4),
    )


def design(visit: Linear) -> tuple[Array, Array]:
    """The derivatives (6 n + m d, m d + q) of all equations, those of the steps last, by the nodes
    but the first and the others, and their right sides."""
    n, (m, d) = len(visit.shifts), visit.steps.shape
    shifts, steps = np.zeros((n, 6, m * d)), np.zeros((m, d, m * d))
    for row, node in enumerate(visit.nodes):
        if node > 0:
            shifts[row, :, d * (node - 1) : d * node] = visit.by_robot[row]
    for row in range(m):
        steps[row, :, d * row : d * (row + 1)] = visit.by_later[row]
        if row:
            steps[row, :, d * (row - 1) : d * row] = visit.by_earlier[row]
    by_nodes = np.vstack([shifts.reshape(6 * n, -1), steps.reshape(m * d, -1)])
    by_others = np.vstack([each.reshape(-1, len(visit.prior)) for each in
                           (visit.by_others, visit.steps_by_others)])  # fmt: skip
    right = np.concatenate([visit.shifts.reshape(-1), visit.steps.reshape(-1)])
    return np.hstack([by_nodes, by_others]), right


def blocks(each: Array) -> Array:
    """One block-diagonal matrix of many (n, k, k)."""
    n, k, _ = each.shape
    whole = np.zeros((n, k, n, k))
    whole[np.arange(n), :, np.arange(n)] = each
    return whole.reshape(n * k, n * k)


def slow_misfit(visit: Linear, noise: Noise) -> tuple[float, float]:
    """The restricted likelihood's misfit from the covariance of all equations together, the floor's
    tilt among them, and the χ² in it."""
    by, right = design(visit)
    rows = visit.shifts.size
    covariance = np.zeros((len(right), len(right)))
    covariance[:rows, :rows] = blocks(visit.own)
    covariance[rows:, rows:] = blocks(
        noise.odometry**2 * visit.by_odometry + noise.slip**2 * visit.by_slip + visit.broken
    )
    if noise.jitter is not None:
        variances = noise.jitter.variances
        shaken = covariance[:rows, :rows].reshape(-1, 6, rows // 6, 6)
        for axis in range(6):
            if noise.length > 0 and axis in (3, 4):
                apart = np.linalg.norm(visit.places[:, None] - visit.places, axis=-1)
                shaken[:, axis, :, axis] += variances[axis] * np.exp(-apart / noise.length)
            else:
                shaken[:, axis, :, axis] += variances[axis] * np.eye(rows // 6)
    weighted = np.linalg.solve(covariance, np.column_stack([by, right]))
    prior = np.concatenate([np.zeros(by.shape[1] - len(visit.prior)), visit.prior])
    information = by.T @ weighted[:, :-1] + np.diag(prior)
    pull = weighted[:, :-1].T @ right
    chi2 = float(right @ weighted[:, -1] - pull @ np.linalg.solve(information, pull))
    logs = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
    return chi2 + float(logs), chi2


def slow_likeliest_wrong(visit: Linear, variances: Array, events: Events) -> list[tuple[bool, ...]]:
    """All sets of wrong parts, the likeliest first, by the evidence for what the others show."""
    n, (m, d) = len(visit.shifts), visit.steps.shape
    by, right = design(visit)
    prior = visit.prior.copy()
    prior[:6] += 1 / events.room_variances
    by_steps, steps = by[6 * n :], right[6 * n :]
    weighted = by_steps.T @ np.linalg.inv(blocks(visit.spread))
    information = weighted @ by_steps + np.diag(np.concatenate([np.zeros(m * d), prior]))
    mean = np.linalg.solve(information, weighted @ steps)
    by_shifts = by[: 6 * n]
    error = right[: 6 * n] - by_shifts @ mean
    spread = by_shifts @ np.linalg.solve(information, by_shifts.T)
    spread += blocks(visit.own + np.diag(variances))
    scored = []
    for wrong in product([False, True], repeat=n):
        at = np.flatnonzero(np.repeat(~np.array(wrong), 6))
        part = spread[np.ix_(at, at)]
        score = error[at] @ np.linalg.solve(part, error[at]) + np.linalg.slogdet(part)[1]
        scored.append((float(score) + sum(wrong) * events.wrong_limit, wrong))
    return [wrong for _, wrong in sorted(scored)]
