"""What all corners of one picture err in together: the robot stands otherwise than its node says.

A floor that tilts by a third of a degree or a mast that sways by a millimetre moves all corners of
a picture as one, so more corners do not average it away. With ε the disturbance of the robot in one
picture, of variances Σ, and J the corners' derivative by it, their covariance is I + J Σ Jᵀ. Its
inverse is I - J M⁻¹ Jᵀ with M = Σ⁻¹ + JᵀJ (Woodbury): ε is eliminated from each picture.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.fusion.model.prediction import base_jacobian
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Jitter:
    """The pictures (g) of one camera and robot, those at one node together as one.

    `group` (n,): which one an observation belongs to; `nodes` (g,); `jacobian` (n, 2K, 6);
    `information` (g, 6, 6): M.
    """

    group: np.ndarray
    nodes: np.ndarray
    jacobian: Array
    information: Array
    variances: Array

    @classmethod
    def of(cls, problem: Problem, batch: Batch, state: State) -> "Jitter | None":
        """That of a batch; None where it has none."""
        if batch.jitter is None:
            return None
        by_base = base_jacobian(problem, batch, state)
        jacobian = by_base.reshape(len(by_base), -1, 6)
        return cls.from_jacobian(jacobian, batch.nodes, batch.jitter)

    @classmethod
    def from_jacobian(cls, jacobian: Array, nodes: np.ndarray, variances: Array) -> "Jitter":
        """From the corners' derivatives (n, 2K, 6) at nodes (n,)."""
        each, group = np.unique(nodes, return_inverse=True)
        information = np.zeros((len(each), 6, 6))
        np.add.at(information, group, np.swapaxes(jacobian, 1, 2) @ jacobian)
        information[:, np.arange(6), np.arange(6)] += 1 / variances
        return cls(group, each, jacobian, information, variances)

    def summed(self, rows: Array) -> Array:
        """Rows (n, …) added up by picture, (g, …)."""
        total = np.zeros((len(self.nodes), *rows.shape[1:]))
        np.add.at(total, self.group, rows)
        return total

    def expected(self, residual: Array) -> Array:
        """The disturbance (g, 6) that residuals (n, 2K) are due to, at the least cost."""
        pull = self.summed((np.swapaxes(self.jacobian, 1, 2) @ residual[..., None])[..., 0])
        return -np.linalg.solve(self.information, pull[..., None])[..., 0]

    def compensated(self, residual: Array) -> Array:
        """What is left of residuals (n, 2K) without it."""
        shift = self.expected(residual)[self.group]
        return residual + (self.jacobian @ shift[..., None])[..., 0]

    def eliminated(self, jacobian: Array, residual: Array) -> tuple[Array, Array, float]:
        """Hessian (g, q, q), gradient (g, q) and cost of each picture by other unknowns, from their
        derivatives (n, 2K, q) and residuals (n, 2K), without the disturbance.

        As a sum of squares: what is left of each corner, and the disturbance's own.
        """
        whole = np.concatenate([jacobian, residual[..., None]], axis=-1)
        pull = self.summed(np.swapaxes(self.jacobian, 1, 2) @ whole)
        shift = np.linalg.solve(self.information, pull)
        left = whole - self.jacobian @ shift[self.group]
        square = self.summed(np.swapaxes(left, 1, 2) @ left)
        square += np.swapaxes(shift, 1, 2) @ (shift / self.variances[:, None])
        return square[:, :-1, :-1], square[:, :-1, -1], float(np.sum(square[:, -1, -1]))

    @property
    def log_determinant(self) -> float:
        """ln |I + J Σ Jᵀ| over all pictures."""
        whole = np.linalg.slogdet(self.information)[1].sum()
        return float(whole + len(self.nodes) * np.sum(np.log(self.variances)))
