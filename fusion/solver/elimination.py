"""Eliminates a chain of nodes from the normal equations (Schur complement on the dense part).

With A over the chain's nodes, B its coupling with the dense part and g its gradient, the chain's
part of the reduced information is -BᵀA⁻¹B, that of the gradient -BᵀA⁻¹g, and the nodes' step for a
step y of the dense part -A⁻¹(g + B y). Two implementations agree:

- `BandElimination` solves with A as a band (LAPACK's pbtrf) for all columns of B: the quickest
  where the dense part is small;
- `NestedElimination` exploits that a node sees few of many cameras: every other node is eliminated
  onto its two neighbours and the cameras that it sees, then every other one of those left, and so
  on (nested dissection). The nodes left are coupled with more cameras, but are soon few.
"""

from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from trigpoint.geometry.rotation import Array

from .normal_equations import ChainEquations

# With at least this many columns of the dense part the nested way is quicker (measured).
_MANY_COLUMNS = 60


class Elimination(Protocol):
    """A chain, eliminated. `information` (dense, dense), `gradient` (dense,): to be added to the
    dense part's."""

    information: Array
    gradient: Array

    def nodes(self, dense_step: Array) -> Array:
        """The nodes' step (n, d) for a step of the dense part (back-substitution)."""
        ...


def eliminated(equations: ChainEquations, dense: Array, damping: float) -> Elimination:
    """Eliminate a chain in the quicker way; `dense`: C, before it; `damping`: relative, of A.

    Raises LinAlgError where A is not positive definite.
    """
    if equations.dense_size < _MANY_COLUMNS:
        return BandElimination(equations, damping)
    return NestedElimination(equations, dense, damping)


class BandElimination:
    """`Elimination` by one factorisation of the whole band."""

    def __init__(self, equations: ChainEquations, damping: float) -> None:
        n, d = self._shape = equations.gradient.shape
        band = np.zeros((2 * d, n * d))
        rows, columns = np.tril_indices(d)
        for i, j in zip(rows, columns, strict=True):
            band[i - j, j::d] = equations.diagonal[:, i, j]
        for i in range(d):
            for j in range(d):
                band[d + i - j, j::d] += equations.lower[:, i, j]
        band[0] *= 1 + damping
        coupling = equations.coupling.reshape(n * d, -1)
        right = np.column_stack([equations.gradient.reshape(-1), coupling])
        factor = cholesky_banded(band, lower=True)
        self._solved = cho_solve_banded((factor, True), right)
        reduction = coupling.T @ self._solved
        self.information, self.gradient = -reduction[:, 1:], -reduction[:, 0]

    def nodes(self, dense_step: Array) -> Array:
        return -(self._solved[:, 0] + self._solved[:, 1:] @ dense_step).reshape(self._shape)


class NestedElimination:
    """`Elimination` by nested dissection.

    SuperLU factorises the whole, bordered by B and g, in the order given and without pivoting:

        M = [A  B  g ]     Its trailing factors are those of the border's Schur complement,
            [Bᵀ K  0 ]     K - BᵀA⁻¹B. K is the dense part plus its diagonal and 1, which
            [gᵀ 0  -1]     keeps that well away from 0.
    """

    def __init__(self, equations: ChainEquations, dense: Array, damping: float) -> None:
        n, d = self._shape = equations.gradient.shape
        inner, size = n * d, equations.dense_size
        self._order = _nested_order(n, d)
        border = dense + np.diag(np.abs(np.diagonal(dense)) + 1.0)
        matrix = _bordered(equations, border, self._order, damping)
        try:
            self._factors = splu(
                matrix,
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True, "Equil": False},
            )
        except RuntimeError as reason:
            raise LinAlgError(str(reason)) from None
        if np.any(self._factors.U.diagonal()[:inner] <= 0):
            raise LinAlgError("a chain's information is not positive definite")
        lower, upper = self._factors.L[inner:, inner:], self._factors.U[inner:, inner:]
        self._left = lower.toarray() @ upper.toarray()
        self.information = self._left[:size, :size] - border
        self.gradient = self._left[:size, size]

    def nodes(self, dense_step: Array) -> Array:
        # With the right-hand side that makes the border's unknowns (y, 1), the nodes' are the step.
        right = np.zeros(self._factors.shape[0])
        inner = len(self._order)
        right[inner:] = self._left @ np.append(dense_step, 1.0)
        step = np.empty(inner)
        step[:] = self._factors.solve(right)[:inner][self._order]
        return step.reshape(self._shape)


def _nested_order(n: int, d: int) -> np.ndarray:
    """The place (n d,) of each node's unknowns: nodes 0, 2, 4, … first, then 1, 5, 9, …"""
    number = np.arange(1, n + 1)
    level = np.log2(number & -number)
    place = np.empty(n, dtype=np.int64)
    place[np.argsort(level, kind="stable")] = np.arange(n)
    return (place[:, None] * d + np.arange(d)).reshape(-1)


def _bordered(
    equations: ChainEquations, border: Array, order: np.ndarray, damping: float
) -> csc_array:
    """The matrix M of `NestedElimination`, its nodes in the order given."""
    n, d = equations.gradient.shape
    inner, size = n * d, equations.dense_size
    at, outer = np.arange(inner).reshape(n, d), inner + np.arange(size + 1)
    diagonal = equations.diagonal.copy()
    diagonal[:, np.arange(d), np.arange(d)] *= 1 + damping
    corner = np.zeros((1, size + 1, size + 1))
    corner[0, :size, :size], corner[0, size, size] = border, -1.0
    pairs = [(at[1:], at[:-1], equations.lower[:-1])]
    pairs += [
        (at[part.rows], np.tile(inner + part.columns, (len(part.rows), 1)), part.blocks)
        for part in equations.couplings
    ]
    pairs.append((at, np.full((n, 1), inner + size), equations.gradient[..., None]))
    turned = [(columns, rows, np.swapaxes(values, 1, 2)) for rows, columns, values in pairs]
    blocks = [(at, at, diagonal), *pairs, *turned, (outer[None], outer[None], corner)]
    return _of_blocks(blocks, np.concatenate([order, outer]))


def _of_blocks(blocks: list[tuple[np.ndarray, np.ndarray, Array]], place: np.ndarray) -> csc_array:
    """A square matrix of blocks (m, r, c) at rows (m, r) and columns (m, c), with each row and
    column at its place.

    The entries are written in place: each copy of an hour's matrix is tens of megabytes.
    """
    count, size = sum(values.size for *_, values in blocks), len(place)
    place = place.astype(np.int32)
    entries, row, column = np.empty(count), np.empty(count, np.int32), np.empty(count, np.int32)
    start = 0
    for rows, columns, values in blocks:
        part, shape = slice(start, start + values.size), values.shape
        entries[part].reshape(shape)[:] = values
        row[part].reshape(shape)[:] = place[rows][:, :, None]
        column[part].reshape(shape)[:] = place[columns][:, None]
        start = part.stop
    return csc_array((entries, (row, column)), shape=(size, size))
