"""A visit linearised with numpy, part by part; the core is held to it."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.prediction import batch_jacobian, odometry_terms
from trigpoint.geometry.rotation import Array

from .picture_jitter import base_jacobian


class SlowLinear(Struct, frozen=True):
    """`linear.Linear` as far as the core makes it; columns of `by_others` as the problem has
    them, of the dense part."""

    shifts: Array
    own: Array
    by_robot: Array
    by_others: Array
    nodes: np.ndarray
    steps: Array
    by_earlier: Array
    by_later: Array
    by_scale: Array


def slow_linear(assembled: Assembled, parts: list[tuple[int, slice]]) -> SlowLinear:
    """About the start of a problem of one batch; `parts`: rows of the batch, and which of their
    corners."""
    problem, state = assembled.problem, assembled.start
    (batch,) = problem.batches
    chain = problem.chains[batch.robot]
    assert chain.motion is not None
    jacobian, residual, names = batch_jacobian(problem, batch, state)
    by_base = base_jacobian(batch, state)
    d = len(chain.tangent)
    shifts, own, by = [], [], []
    for row, part in parts:
        pose, unknowns = by_base[row, part].reshape(-1, 6), jacobian[row, part]
        covariance = np.linalg.inv(pose.T @ pose)
        shifts.append(-covariance @ pose.T @ residual[row, part].ravel())
        by.append(covariance @ pose.T @ unknowns.reshape(len(pose), -1))
        own.append(covariance)
    by_others = np.zeros((len(parts), 6, problem.layout.size))
    by_others[..., names] = np.array(by)[..., d:]
    unit = replace(chain.motion, covariance=np.tile(np.eye(6), (len(chain) - 1, 1, 1)))
    poses = state.robots[batch.robot].map_from_base
    terms = odometry_terms(poses[:-1], poses[1:], unit, chain.tangent)
    return SlowLinear(
        np.array(shifts),
        np.array(own),
        np.array(by)[..., :d],
        by_others,
        batch.nodes[[row for row, _ in parts]],
        -terms.residual,
        terms.by_earlier,
        terms.by_later,
        terms.by_scale,
    )
