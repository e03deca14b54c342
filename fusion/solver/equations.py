"""The normal equations of a problem at a state, held by the core, and what they tell."""

import numpy as np
from msgspec import Struct
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.problem import Layout, Problem
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric
from trigpoint.native.library import Handle, Kernel, Out

# Information of a pose that is known exactly: 0.3 µm and µrad.
EXACT = 1e13


class Reduced(Struct, frozen=True):
    """The dense part after the chains are eliminated: information and gradient at a state."""

    layout: Layout
    information: Array
    gradient: Array

    def covariance(self) -> Array:
        """Joint covariance of the dense part; raise LinAlgError where it is not determined."""
        return covariance_of(self.information)


class System(Struct, frozen=True):
    """The full system of a small problem at a state. `covariance`: of all unknowns, the chains'
    inner nodes first, and then the dense part; `step`: from there to the minimum;
    `log_determinant`: of the covariance's inverse, without what holds an anchored chain's first
    node, plus that of the pictures' jitter; `first_row`: by robot, the first row of its nodes;
    `dense_row`: the first of the dense part."""

    problem: Problem
    cost: float
    covariance: Array
    step: Array
    log_determinant: float
    first_row: dict[str, int]
    dense_row: int

    def node_rows(self, robot: str, node: int) -> np.ndarray:
        """The rows (d,) of a robot's node."""
        chain = self.problem.chains[robot]
        d = len(chain.tangent)
        if node == len(chain) - 1:
            return self.dense_row + self.problem.layout.last[robot]
        return self.first_row[robot] + node * d + np.arange(d)


class EquationsHandle(Handle):
    """Normal equations, held by the core."""

    name = "tp_equations"


class Equations(Struct, frozen=True):
    """Half the Hessian and the gradient of the cost Σ|r/σ|² of a problem at a state; `cost`:
    there."""

    problem: Problem
    cost: float
    handle: EquationsHandle

    def reduced(self) -> Reduced:
        """Eliminate the chains, in a time linear in the number of nodes: what remains is the Schur
        complement on the dense part, S = C - BᵀA⁻¹B, and S⁻¹ its marginal covariance. Raises
        LinAlgError where a chain is not determined or the cost is not finite."""
        size = self.problem.layout.size
        information, gradient = np.empty((size, size)), np.empty(size)
        if not _REDUCED(self.handle, information, gradient):
            raise LinAlgError("a chain's information is not positive definite")
        return Reduced(self.problem.layout, information, gradient)

    def system(self) -> System:
        """Invert the whole; raise LinAlgError where an unknown is not determined or the cost is not
        finite."""
        rows, dense_row = {}, 0
        for name, chain in self.problem.chains.items():
            rows[name] = dense_row
            dense_row += (len(chain) - 1) * len(chain.tangent)
        total = dense_row + self.problem.layout.size
        covariance, step, determinant = np.empty((total, total)), np.empty(total), np.empty(1)
        if not _SYSTEM(self.handle, covariance, step, determinant):
            raise LinAlgError("the equations are singular: an unknown is not determined")
        log_determinant = float(determinant[0])
        return System(self.problem, self.cost, covariance, step, log_determinant, rows, dense_row)


_REDUCED = Kernel(
    "tp_reduced", EquationsHandle, Out(np.float64, ("u", "u")), Out(np.float64, ("u",))
)
_SYSTEM = Kernel(
    "tp_full_system",
    EquationsHandle,
    Out(np.float64, ("u", "u")),
    Out(np.float64, ("u",)),
    Out(np.float64, (1,)),
)


def covariance_of(information: Array) -> Array:
    """Inverse of an information matrix after scaling its diagonal to 1; raise LinAlgError where it
    is not positive definite."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = symmetric(information) * scale[:, None] * scale
    if not np.all(np.isfinite(scaled)):
        raise LinAlgError("the information is not finite")
    inverse_root = np.linalg.inv(np.linalg.cholesky(scaled))
    return inverse_root.T @ inverse_root * scale[:, None] * scale
