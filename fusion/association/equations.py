"""Normal equations assembled from small blocks, for many graphs of one shape at once.

Small ones are held dense and factorised all together; large ones, which are nearly all zeros, are
factorised one by one by SuperLU. Both scale the unknowns first, so that those known exactly and
those hardly known have equations of comparable magnitude.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from trigpoint.geometry.rotation import Array

# The number of unknowns from which a sparse factorisation is the faster one, as measured.
SPARSE_FROM = 100


class Factor(Protocol):
    """The factorised information matrix of n unknowns."""

    @property
    def log_determinant(self) -> float: ...

    def covariance(self, rows: np.ndarray) -> Array:
        """Return the marginal covariance (k, k) of the unknowns in these rows."""
        ...


class Pattern:
    """The sparsity pattern of the normal equations of `size` unknowns. `rows`: for each kind of
    block, the unknowns (k, m) of its k blocks, none twice in one block."""

    def __init__(self, size: int, rows: Sequence[np.ndarray]) -> None:
        self.size = size
        pairs = [r[:, :, None] * size + r[:, None, :] for r in rows]
        self._order, self._starts, self.at = _summed_at(pairs)
        self._gradient_order, self._gradient_starts, self._gradient_at = _summed_at(rows)
        row = self.at // size if size else self.at
        self.ends = np.searchsorted(row, np.arange(size + 1))
        self.diagonal = np.searchsorted(self.at, np.arange(size) * (size + 1))

    def equations(
        self, hessians: Sequence[Array], gradients: Sequence[Array], *, count: int
    ) -> "Equations":
        """Assemble the equations of `count` (b) graphs: sum the blocks of the Hessians
        (b, k, m, m) and gradients (b, k, m), given in the order of the pattern's rows."""
        if not self.size:
            return Equations(self, np.zeros((count, 0)), np.zeros((count, 0)))
        values = _summed(hessians, self._order, self._starts)
        gradient = np.zeros((count, self.size))
        gradient[:, self._gradient_at] = _summed(
            gradients, self._gradient_order, self._gradient_starts
        )
        return Equations(self, values, gradient)


class Equations:
    """The normal equations of b graphs: `values` (b, e), the matrix's entries at the positions of
    the pattern, and `gradient` (b, n). Raise LinAlgError if nothing is said of an unknown."""

    def __init__(self, pattern: Pattern, values: Array, gradient: Array) -> None:
        self._pattern, self.gradient = pattern, gradient
        diagonal = values[:, pattern.diagonal]
        if not np.all(diagonal > 0):
            raise np.linalg.LinAlgError("an unknown of which nothing is said")
        self._scale = 1 / np.sqrt(diagonal)
        row, column = np.divmod(pattern.at, max(pattern.size, 1))
        self._values = values * self._scale[:, row] * self._scale[:, column]
        self._column = column

    @property
    def _is_sparse(self) -> bool:
        return self._pattern.size >= SPARSE_FROM

    def step(self) -> Array:
        """Return the step (b, n) to the minimum; raise LinAlgError if a matrix is singular."""
        wanted = self._scale * self.gradient
        if self._is_sparse:
            solved = [f.solve(w) for f, w in zip(self._sparse, wanted, strict=True)]
            return -self._scale * np.array(solved)
        return -self._scale * np.linalg.solve(self._dense(), wanted[..., None])[..., 0]

    def factors(self) -> Sequence[Factor]:
        """Factorise the matrix of each graph; raise LinAlgError if one is not positive definite."""
        if self._is_sparse:
            pairs = zip(self._sparse, self._scale, strict=True)
            return [_Sparse.of(factor, scale) for factor, scale in pairs]
        lower = np.linalg.cholesky(self._dense()) / self._scale[..., None]
        logarithms = np.log(np.diagonal(lower, axis1=1, axis2=2))
        sums = 2 * np.sum(logarithms, axis=1)
        return [_Dense(float(s), f.copy()) for s, f in zip(sums, lower, strict=True)]

    def _dense(self) -> Array:
        size = self._pattern.size
        matrix = np.zeros((len(self._values), size, size))
        matrix.reshape(len(matrix), size * size)[:, self._pattern.at] = self._values
        return matrix

    @cached_property
    def _sparse(self) -> list[SuperLU]:
        shape = self._pattern.size, self._pattern.size
        return [
            _factorised(csc_array((row, self._column, self._pattern.ends), shape=shape))
            for row in self._values
        ]


@dataclass(frozen=True, slots=True)
class _Dense:
    """A dense factor. `lower` (n, n): the Cholesky factor of the unscaled matrix."""

    log_determinant: float
    lower: Array

    def covariance(self, rows: np.ndarray) -> Array:
        unit = np.zeros((len(self.lower), len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        half = solve_triangular(self.lower, unit, lower=True, check_finite=False)
        return half.T @ half


@dataclass(frozen=True, slots=True)
class _Sparse:
    """A sparse factor. `factor`: of the matrix scaled by `scale` (n,) on both sides."""

    log_determinant: float
    factor: SuperLU
    scale: Array

    @classmethod
    def of(cls, factor: SuperLU, scale: Array) -> "_Sparse":
        pivots = factor.U.diagonal()
        if not np.all(pivots > 0):
            raise np.linalg.LinAlgError("not positive definite")
        return cls(float(np.sum(np.log(pivots)) - 2 * np.sum(np.log(scale))), factor, scale)

    def covariance(self, rows: np.ndarray) -> Array:
        unit = np.zeros((len(self.scale), len(rows)))
        unit[rows, np.arange(len(rows))] = self.scale[rows]
        found = self.scale[rows, None] * self.factor.solve(unit)[rows]
        return 0.5 * (found + found.T)


def _factorised(matrix: csc_array) -> SuperLU:
    """Factorise a symmetric, positive definite matrix with its pivots on the diagonal; raise
    LinAlgError if it is exactly singular."""
    try:
        return splu(
            matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as reason:  # exactly singular
        raise np.linalg.LinAlgError(str(reason)) from reason


def _summed_at(positions: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plan how the numbers at these positions are summed: the order that sorts them by position,
    where in it each sum begins, and the rising positions of the sums."""
    flat = np.concatenate([np.zeros(0, int), *(each.ravel() for each in positions)])
    order = np.argsort(flat, kind="stable")
    rising = flat[order]
    starts = np.flatnonzero(np.diff(rising, prepend=-1))
    return order, starts, rising[starts]


def _summed(blocks: Sequence[Array], order: np.ndarray, starts: np.ndarray) -> Array:
    """Sum blocks (b, …) at the positions that they share, as `_summed_at` planned it: (b, e)."""
    flat = np.concatenate([each.reshape(len(each), -1) for each in blocks], axis=1)
    return np.add.reduceat(flat[:, order], starts, axis=1)
