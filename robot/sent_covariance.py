"""A correction's covariance as it goes to the robot: what is judged is what is sent.

Every protocol carries the upper triangle in single precision. So a covariance is rounded to that
first, and then looked at; what comes out of the fusing is rounded the same way.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

# Ten micrometres, and as many microradians: no camera sees that, and the square of much less is
# an exact zero in single precision.
LEAST_SIGMA = 1e-5
# Of the correlation matrix's smallest eigenvalue: single precision rounds at 6e-8.
_LEAST_EIGENVALUE = 1e-6
# Two halves of one matrix that were computed and rounded separately agree better than this.
_ASYMMETRY = 1e-6


def as_sent(covariance: Array) -> Array:
    """The covariance (n, n) that the receiver has, who mirrors the upper triangle."""
    with np.errstate(over="ignore", under="ignore"):
        sent = covariance.astype(np.float32).astype(float)
    return np.where(_below(len(sent)), sent.T, sent)


@cache
def _below(size: int) -> NDArray[np.bool_]:
    """Which elements of a matrix lie below its diagonal."""
    return np.tri(size, k=-1, dtype=bool)


def covariance_fault(covariance: Array) -> str:
    """What is wrong with a covariance (n, n) that a robot is to be told, or ""."""
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
