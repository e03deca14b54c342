"""Sightings of a robot that stands still repeat each other's errors.

A corner's error is partly noise, new in every picture, and partly systematic: how the pixel grid
cuts the pattern, what the lens model leaves over. While the robot moves that part changes too
from picture to picture; while it stands, it stays, and many pictures know little more than one. How
large it is shows in the pictures themselves: the mean residual of a corner over a standstill is
smaller than one residual by the root of their number only where errors are independent.
"""

from collections import defaultdict

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.odometry import PLANAR
from trigpoint.fusion.model.prediction import batch_jacobian, batch_residual
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.geometry.rotation import Array

_LEAST_PICTURES = 3
# Standard deviations by which the mean residuals must be too large to be those of noise.
_SIGNIFICANT = 3.0
_CHANGED = 0.1
_OUT_OF_PLANE = 3


def share_out(data: DataSet, assembled: Assembled, state: State) -> bool:
    """Set the share of every used observation in the data set; whether one changed by a tenth."""
    changed = False
    for batch in assembled.problem.batches:
        residual = batch_residual(batch, state)
        residual = residual / np.sqrt(batch.shares)[:, None, None]
        common = _common_share(assembled.problem, batch, state)
        for rows in _standstills(batch):
            share = common * _share(batch, residual, rows)
            for source in batch.sources[rows]:
                entry = data.entries[int(source)]
                changed |= abs(entry.share - share) > _CHANGED * entry.share
                entry.share = share
    return changed


def _standstills(batch: Batch) -> list[np.ndarray]:
    """Rows of a batch that share a node: the robot stood still between them."""
    groups: dict[int, list[int]] = defaultdict(list)
    for row, node in enumerate(batch.nodes.tolist()):
        groups[node].append(row)
    return [np.array(rows) for rows in groups.values()]


def _share(batch: Batch, residual: Array, rows: np.ndarray) -> float:
    """How much each of n pictures counts: 1/(1 + n b²), with b² the variance of the systematic part
    in units of sigma²; then together they count as one picture with the error b² + 1/n."""
    if len(rows) < _LEAST_PICTURES:
        return 1.0
    table = _by_corner(batch, residual, rows)
    counts = np.sum(np.isfinite(table[..., 0]), axis=0)
    table, counts = table[:, counts >= _LEAST_PICTURES], counts[counts >= _LEAST_PICTURES]
    if len(counts) == 0:
        return 1.0
    number = float(counts.mean())
    noise = float(np.mean(np.nanvar(table, axis=0, ddof=1))) / number
    mean_square = float(np.mean(np.nanmean(table, axis=0) ** 2))
    limit = noise * (1 + _SIGNIFICANT * np.sqrt(2 / (2 * len(counts))))
    systematic = mean_square - noise if mean_square > limit else 0.0
    return 1 / (1 + number * systematic)


def _common_share(problem: Problem, batch: Batch, state: State) -> float:
    """How much each observation of a batch counts, since a view's corners err together.

    A planar robot cannot rise, pitch or roll, so what its pictures gain by letting it do so is
    error: χ² of three degrees of freedom a picture where corners err independently and the floor
    is even, and proportionally more where a picture is less informative than its corners suggest.
    """
    chain = problem.chains[batch.robot]
    if not chain.planar or batch.jitter is not None:
        return 1.0
    spatial = replace(problem, chains={**problem.chains, batch.robot: replace(chain, planar=False)})
    jacobian, residual, _ = batch_jacobian(spatial, batch, state)
    n = len(batch.nodes)
    scale = np.sqrt(batch.shares)[:, None]
    residual = residual.reshape(n, -1) / scale
    jacobian = jacobian[..., :6].reshape(n, -1, 6) / scale[..., None]
    gain = _explained(jacobian, residual) - _explained(jacobian[..., PLANAR], residual)
    ratio = float(np.mean(gain)) / _OUT_OF_PLANE
    limit = 1 + _SIGNIFICANT * np.sqrt(2 / (_OUT_OF_PLANE * n))
    return 1 / ratio if ratio > limit else 1.0


def _explained(jacobian: Array, residual: Array) -> Array:
    """The decrease of χ² (n,) by fitting unknowns (n, m, k) to residuals (n, m), row by row."""
    gradient = (np.swapaxes(jacobian, 1, 2) @ residual[..., None])[..., 0]
    hessian = np.swapaxes(jacobian, 1, 2) @ jacobian
    step = (np.linalg.pinv(hessian, hermitian=True) @ gradient[..., None])[..., 0]
    return np.sum(gradient * step, axis=1)


def _by_corner(batch: Batch, residual: Array, rows: np.ndarray) -> Array:
    """Residuals (n, corners, 2) in sigmas, a column a corner; NaN where a picture lacks it."""
    columns: dict[tuple[int, ...], int] = {}
    cells = []
    for order, row in enumerate(rows):
        for k in np.flatnonzero(batch.weights[row] > 0):
            # Half a micrometre tells corners apart.
            point = np.round(batch.face_points[row, k] * 2e6).astype(int)
            corner = (int(batch.faces[row, k]), *point.tolist())
            cells.append((order, columns.setdefault(corner, len(columns)), row, k))
    table = np.full((len(rows), len(columns), 2), np.nan)
    for order, column, row, k in cells:
        table[order, column] = residual[row, k]
    return table
