"""A correction's covariance as sent to the robot, so that exactly this is judged.

Every protocol carries the upper triangle in single precision. So a covariance is first rounded to
that and then judged; the result of fusing is rounded in the same way.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from trigpoint.contract.correction import LEAST_SIGMA
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

# Of the correlation matrix's smallest eigenvalue: single precision rounds at 6e-8.
_LEAST_EIGENVALUE = 1e-6
# Two halves of one matrix that were computed and rounded separately agree better than this.
_ASYMMETRY = 1e-6


def as_sent(covariance: Array) -> Array:
    """The covariance (n, n) at the receiver, which mirrors the upper triangle."""
    with np.errstate(over="ignore", under="ignore"):
        sent = covariance.astype(np.float32).astype(float)
    return np.where(_below(len(sent)), sent.T, sent)


@cache
def _below(size: int) -> NDArray[np.bool_]:
    """Mask of the elements below a matrix's diagonal."""
    return np.tri(size, k=-1, dtype=bool)


def covariance_fault(covariance: Array) -> str:
    """What is wrong with a covariance (n, n) to be sent to a robot, or ""."""
    if not np.all(np.isfinite(covariance)):
        return "its covariance is not finite"
    sent = as_sent(covariance)
    variances = np.diag(sent)
    if not np.all(np.isfinite(sent)) or np.any(variances <= 0):
        return "its covariance is not positive"
    if np.any(variances < LEAST_SIGMA**2):
        return f"its sigma is below {LEAST_SIGMA:g} m or rad, which nothing measures"
    scale = 1 / np.sqrt(variances)
    if np.max(np.abs((covariance - covariance.T) * np.outer(scale, scale))) > _ASYMMETRY:
        return "its covariance is not symmetric"
    if np.linalg.eigvalsh(symmetric(sent * np.outer(scale, scale)))[0] < _LEAST_EIGENVALUE:
        return "its covariance is not positive"
    return ""
