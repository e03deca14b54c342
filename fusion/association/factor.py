"""The factorised information matrix of a graph's unknowns, held by the core."""

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import Handle, In, Kernel, Out


class Factor(Handle):
    """The factorised information matrix of a graph at its minimum."""

    name = "tp_factor"

    def covariance(self, rows: np.ndarray) -> Array:
        """Return the marginal covariance (k, k) of the unknowns in these rows. Raises RuntimeError
        where nothing is factorised, or a row is none of its unknowns."""
        found = np.empty((len(rows), len(rows)))
        _COVARIANCE(self, np.ascontiguousarray(rows, dtype=np.int64), found)
        return found


_COVARIANCE = Kernel(
    "tp_factor_covariance", Factor, In(np.int64, ("k",)), Out(np.float64, ("k", "k"))
)
