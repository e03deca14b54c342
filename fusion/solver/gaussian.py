"""A Gaussian of many unknowns that is updated by measurements of few of them.

A sighting bears on one robot and one camera, and what it says of all the others follows from their
covariance with those two. So only the columns that were used lately, the near ones (n), are
kept up to date; the far ones (f) are kept as functions of an earlier Gaussian, marked by ⁰
(Guivant and Nebot, «Optimization of the simultaneous localization and map-building algorithm for
real-time implementation», 2001):

    P_nf = Φ P⁰_nf        P_ff = P⁰_ff - P⁰_fn Ψ P⁰_nf        m_f = m⁰_f + P⁰_fn θ

The time of a step then depends on the number of near columns alone, and the step is exact. A column
is made near when it is asked for; when there would be too many near ones, everything is evaluated
once and becomes the new earlier Gaussian.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from trigpoint.geometry.rotation import Array

# The most near columns: with so many, updating them is still quicker than anything else in a step.
# Where there is time, everything is evaluated at half of that.
_MOST_NEAR = 64


@dataclass(frozen=True, slots=True)
class _Near:
    """The near columns (k,) with their mean and covariance, and Φ (`carry`), Ψ (`weight`), θ
    (`pull`) of the module's formulas."""

    columns: np.ndarray
    mean: Array
    covariance: Array
    carry: Array
    weight: Array
    pull: Array

    @classmethod
    def none(cls) -> "_Near":
        nothing, square = np.zeros(0), np.zeros((0, 0))
        return cls(np.zeros(0, dtype=int), nothing, square, square, square, nothing)

    def learning(self, free: np.ndarray, gain: Array, far: Array, whitened: Array) -> "_Near":
        """After an update of the free columns alone; `gain` (k, r), `far` (k, r), `whitened` (r,):
        as `Gaussian.updated` names them."""
        own = np.where(np.isin(self.columns, free)[:, None], gain, 0.0)
        across = own @ gain.T
        return replace(
            self,
            mean=self.mean - own @ whitened,
            covariance=self.covariance - across - across.T + own @ own.T,
            carry=self.carry - own @ far.T,
        )

    def rows(self, columns: np.ndarray) -> np.ndarray:
        """The indices of columns (m,), all of them near, among the near ones."""
        return np.argmax(self.columns == columns[:, None], axis=1)

    def lacks(self, columns: np.ndarray) -> np.ndarray:
        """Which columns (m,) are not near, bool."""
        return ~np.any(self.columns == columns[:, None], axis=1)


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A Gaussian of n unknowns; immutable. `before`: earlier mean (n,) and covariance (n, n)."""

    before: tuple[Array, Array]
    _near: _Near = field(default_factory=_Near.none)

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> "Gaussian":
        """From its mean (n,) and covariance (n, n), which must not be modified any more."""
        return cls((mean, covariance))

    @cached_property
    def mean(self) -> Array:
        """The mean of all unknowns, (n,)."""
        near, (mean, covariance) = self._near, self.before
        whole = mean + covariance[:, near.columns] @ near.pull
        whole[near.columns] = near.mean
        return whole

    @cached_property
    def covariance(self) -> Array:
        """The full covariance, (n, n); takes time and memory quadratic in n."""
        near, (_, covariance) = self._near, self.before
        across = covariance[near.columns]
        whole = covariance - across.T @ (near.weight @ across)
        rows = near.carry @ across
        whole[near.columns], whole[:, near.columns] = rows, rows.T
        whole[np.ix_(near.columns, near.columns)] = near.covariance
        return whole

    @property
    def is_worth_settling(self) -> bool:
        """Whether one of the next steps will have to evaluate the full covariance."""
        return len(self._near.columns) > _MOST_NEAR // 2

    def settled(self) -> "Gaussian":
        """The same Gaussian, evaluated: no column is near and no history is kept."""
        return Gaussian.of(self.mean, self.covariance) if len(self._near.columns) else self

    def mean_of(self, columns: np.ndarray) -> Array:
        """The mean of some columns (m,), (m,)."""
        near = self._with_near(columns)
        return near.mean[near.rows(columns)]

    def covariance_of(self, columns: np.ndarray) -> Array:
        """The marginal covariance of some columns (m,), (m, m)."""
        near = self._with_near(columns)
        rows = near.rows(columns)
        return near.covariance[np.ix_(rows, rows)]

    def blocks(self, columns: np.ndarray) -> Array:
        """Marginal covariances (b, m, m) of groups of columns (b, m), each by itself."""
        near, (_, covariance) = self._near, self.before
        across = covariance[np.ix_(near.columns, columns.reshape(-1))]
        across = np.moveaxis(across.reshape(len(near.columns), *columns.shape), 0, 1)
        pairs = covariance[columns[:, :, None], columns[:, None, :]]
        found = pairs - np.swapaxes(across, 1, 2) @ (near.weight @ across)
        for group in np.flatnonzero(np.isin(columns, near.columns).any(axis=1)):
            found[group] = self.covariance_of(columns[group])
        return found

    def moved(
        self, columns: np.ndarray, of: np.ndarray, matrix: Array, shift: Array, noise: Array
    ) -> "Gaussian":
        """The Gaussian with columns (m,) replaced by matrix (m, k) times columns `of` (k,),
        plus a shift (m,) and noise of covariance (m, m)."""
        ready = self._ready(np.unique(np.concatenate([columns, of])))
        near = ready._near
        rows, source = near.rows(columns), near.rows(of)
        mean, covariance, carry = near.mean.copy(), near.covariance.copy(), near.carry.copy()
        mean[rows], carry[rows] = matrix @ mean[source] + shift, matrix @ carry[source]
        across = matrix @ covariance[source]
        own = across[:, source] @ matrix.T + noise
        covariance[rows], covariance[:, rows] = across, across.T
        covariance[np.ix_(rows, rows)] = own
        moved = replace(near, mean=mean, covariance=covariance, carry=carry)
        return Gaussian(ready.before, moved)

    def updated(
        self,
        columns: np.ndarray,
        jacobian: Array,
        residual: Array,
        *,
        free: np.ndarray | None = None,
    ) -> tuple["Gaussian", Array]:
        """The Gaussian after an update by residual (r,) + jacobian (r, m) · columns (m,) = noise of
        unit variance; also the whitened innovation (r,).

        `residual`: where the unknowns are 0, not at the mean. With H the Jacobian by the near
        columns, S = 1 + H P_nn Hᵀ = L Lᵀ and G = P_nn Hᵀ L⁻ᵀ the gain of the near ones, that of the
        far ones is P⁰_fn W, W = Φᵀ Hᵀ L⁻ᵀ.

        `free`: the columns, some of those, that the update may change (None: all). The others keep
        mean and covariance and are only considered: their errors go on into what is learnt of the
        free ones (Schmidt, «Application of state-space methods to navigation problems», 1966). With
        the gain G and that of the free ones alone G′, P′ = P - G′Gᵀ - GG′ᵀ + G′G′ᵀ.
        """
        ready = self._ready(columns)
        near = ready._near
        rows = near.rows(columns)
        spread = near.covariance[:, rows] @ jacobian.T
        root = np.linalg.cholesky(np.eye(len(jacobian)) + jacobian @ spread[rows])
        innovation = residual + jacobian @ near.mean[rows]
        both = np.concatenate([spread, near.carry[rows].T @ jacobian.T, innovation[None]])
        solved = np.linalg.solve(root, both.T).T
        gain, far, whitened = np.split(solved, [len(spread), 2 * len(spread)])
        if free is not None:
            return Gaussian(ready.before, near.learning(free, gain, far, whitened[0])), whitened[0]
        after = _Near(
            near.columns,
            near.mean - gain @ whitened[0],
            near.covariance - gain @ gain.T,
            near.carry - gain @ far.T,
            near.weight + far @ far.T,
            near.pull - far @ whitened[0],
        )
        return Gaussian(ready.before, after), whitened[0]

    def _ready(self, columns: np.ndarray) -> "Gaussian":
        """The same with these columns (m,) among the near ones."""
        near = self._with_near(columns)
        if near is self._near:
            return self
        if len(near.columns) > max(_MOST_NEAR, len(columns)):
            return self.settled()._ready(columns)
        return Gaussian(self.before, near)

    def _with_near(self, columns: np.ndarray) -> _Near:
        """The near columns extended by these (m,), each once."""
        near, (mean, covariance) = self._near, self.before
        added = columns[near.lacks(columns)]
        if not len(added):
            return near
        k, m = len(near.columns), len(added)
        across = covariance[np.ix_(near.columns, added)]
        weighted = near.weight @ across
        larger, carry, weight = np.zeros((3, k + m, k + m))
        larger[:k, :k], larger[:k, k:] = near.covariance, near.carry @ across
        larger[k:, :k] = larger[:k, k:].T
        larger[k:, k:] = covariance[np.ix_(added, added)] - across.T @ weighted
        carry[:k, :k], carry[k:, :k], carry[k:, k:] = near.carry, -weighted.T, np.eye(m)
        weight[:k, :k] = near.weight
        return _Near(
            np.concatenate([near.columns, added]),
            np.concatenate([near.mean, mean[added] + across.T @ near.pull]),
            larger,
            carry,
            weight,
            np.concatenate([near.pull, np.zeros(m)]),
        )
