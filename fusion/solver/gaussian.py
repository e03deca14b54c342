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

from functools import cached_property

import numpy as np
from msgspec import Struct, field
from numpy.linalg import LinAlgError

from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique
from trigpoint.native.library import In, Kernel, Out

# The most near columns: with so many, updating them is still quicker than anything else in a step.
# Where there is time, everything is evaluated at half of that.
_MOST_NEAR = 64
_REAL, _WHOLE = np.float64, np.int64
_EXTENDED = Kernel(
    "tp_near_extended",
    *(In(_REAL, ("n",)), In(_REAL, ("n", "n")), In(_WHOLE, ("k",)), In(_REAL, ("t", "k"))),
    *(In(_WHOLE, ("m",)), Out(_REAL, ("u", "l"))),
)
_MOVED = Kernel(
    "tp_near_moved",
    *(In(_REAL, ("t", "k")), In(_WHOLE, ("m",)), In(_WHOLE, ("q",)), In(_REAL, ("m", "q"))),
    *(In(_REAL, ("m",)), In(_REAL, ("m", "m")), Out(_REAL, ("t", "k"))),
)
_UPDATED = Kernel(
    "tp_near_updated",
    *(In(_REAL, ("t", "k")), In(_WHOLE, ("m",)), In(_REAL, ("r", "m")), In(_REAL, ("r",))),
    *(In(_WHOLE, ("f",)), int, Out(_REAL, ("t", "k")), Out(_REAL, ("r",))),
)


class _Near(Struct, frozen=True):
    """The near columns (k,), and of the module's formulas P_nn, Φ, Ψ (k rows each), m_n and θ (one
    each), one below the other: (3 k + 2, k)."""

    columns: np.ndarray
    table: Array

    @classmethod
    def none(cls) -> "_Near":
        return cls(np.zeros(0, dtype=np.int64), np.zeros((2, 0)))

    @property
    def covariance(self) -> Array:
        return self.table[: len(self.columns)]

    @property
    def carry(self) -> Array:
        return self.table[len(self.columns) : 2 * len(self.columns)]

    @property
    def weight(self) -> Array:
        return self.table[2 * len(self.columns) : -2]

    @property
    def mean(self) -> Array:
        return self.table[-2]

    @property
    def pull(self) -> Array:
        return self.table[-1]

    def rows(self, columns: np.ndarray) -> np.ndarray:
        """The indices of columns (m,), all of them near, among the near ones."""
        return np.argmax(self.columns == columns[:, None], axis=1)

    def lacks(self, columns: np.ndarray) -> np.ndarray:
        """Which columns (m,) are not near, bool."""
        return ~np.any(self.columns == columns[:, None], axis=1)


class Gaussian(Struct, eq=False, dict=True):
    """A Gaussian of n unknowns; what it says never changes. `before`: earlier mean (n,) and
    covariance (n, n)."""

    before: tuple[Array, Array]
    _near: _Near = field(default_factory=_Near.none)

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> "Gaussian":
        """From its mean (n,) and covariance (n, n), which must not be modified any more."""
        return cls((np.ascontiguousarray(mean), np.ascontiguousarray(covariance)))

    @cached_property
    def mean(self) -> Array:
        """The mean of all unknowns, (n,)."""
        near, (mean, covariance) = self._near, self.before
        if not len(near.columns):
            return mean
        whole = mean + covariance[:, near.columns] @ near.pull
        whole[near.columns] = near.mean
        return whole

    @cached_property
    def covariance(self) -> Array:
        """The full covariance, (n, n); takes time and memory quadratic in n."""
        near, (_, covariance) = self._near, self.before
        if not len(near.columns):
            return covariance
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
        return self.copy() if len(self._near.columns) else self

    def copy(self) -> "Gaussian":
        """The same Gaussian for another thread, evaluated."""
        return Gaussian.of(self.mean, self.covariance)

    def mean_of(self, columns: np.ndarray) -> Array:
        """The mean of some columns (m,), (m,)."""
        near = self._asked(columns)
        return near.mean[near.rows(columns)]

    def covariance_of(self, columns: np.ndarray) -> Array:
        """The marginal covariance of some columns (m,), (m, m)."""
        near = self._asked(columns)
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
        ready = self._ready(unique(np.concatenate([columns, of])))
        near = ready._near
        table = np.empty_like(near.table)
        _MOVED(
            *(near.table, near.rows(columns), near.rows(of)),
            *(*map(np.ascontiguousarray, (matrix, shift, noise)), table),
        )
        return Gaussian(ready.before, _Near(near.columns, table))

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

        `residual`: where the unknowns are 0, not at the mean. Raises LinAlgError where the
        innovation's covariance is not positive definite.

        `free`: the columns, some of those, that the update may change (None: all). The others keep
        mean and covariance and are only considered: their errors go on into what is learnt of the
        free ones (Schmidt, «Application of state-space methods to navigation problems», 1966). With
        the gain G and that of the free ones alone G′, P′ = P - G′Gᵀ - GG′ᵀ + G′G′ᵀ.
        """
        ready = self._ready(columns)
        near = ready._near
        table, whitened = np.empty_like(near.table), np.empty(len(residual))
        is_sound = _UPDATED(
            *(near.table, near.rows(columns), np.ascontiguousarray(jacobian)),
            *(np.ascontiguousarray(residual), near.rows(columns if free is None else free)),
            *(free is None, table, whitened),
        )
        if not is_sound:
            raise LinAlgError("an innovation's covariance is not positive definite")
        return Gaussian(ready.before, _Near(near.columns, table)), whitened

    def _ready(self, columns: np.ndarray) -> "Gaussian":
        """The same with these columns (m,) among the near ones."""
        if self._asked(columns) is self._near:
            return self
        settled = self.settled()
        settled._near = settled._with_near(columns)
        return settled

    def _asked(self, columns: np.ndarray) -> _Near:
        """The near columns and these (m,); kept for the next to ask, where they are not too many:
        which are near is no part of what a Gaussian says. For one thread at a time."""
        near = self._with_near(columns)
        if len(near.columns) <= _MOST_NEAR:
            self._near = near
        return near

    def _with_near(self, columns: np.ndarray) -> _Near:
        """The near columns extended by these (m,), each once."""
        near = self._near
        added = columns[near.lacks(columns)]
        if not len(added):
            return near
        count = len(near.columns) + len(added)
        table = np.empty((3 * count + 2, count))
        _EXTENDED(*self.before, near.columns, near.table, added, table)
        return _Near(np.concatenate([near.columns, added]), table)
