"""What all corners of one picture err in together: the robot stands otherwise than its node says.

A floor that tilts by a third of a degree or a mast that sways by a millimetre moves all corners of
a picture as one, so more corners do not average it away. With ε the disturbance of the robot in one
picture, of variances Σ, and J the corners' derivative by it, their covariance is I + J Σ Jᵀ. Its
inverse is I - J M⁻¹ Jᵀ with M = Σ⁻¹ + JᵀJ (Woodbury): ε is eliminated from each picture. Where the
floor tilts, what is left of a standing robot's pictures has a disturbance in common, which is
eliminated likewise.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.prediction import base_jacobian
from trigpoint.fusion.model.problem import Batch, Problem, State
from trigpoint.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class _Shared:
    """A disturbance (c) that rows (n, r) in a group have in common: `group` (n,); `jacobian`
    (n, r, c); `information` (g, c, c): M; `variances` (c,)."""

    group: np.ndarray
    jacobian: Array
    information: Array
    variances: Array

    @classmethod
    def of(cls, group: np.ndarray, jacobian: Array, variances: Array) -> Self:
        information = _summed(group, np.swapaxes(jacobian, 1, 2) @ jacobian)
        information += np.diag(1 / variances)
        return cls(group, jacobian, information, variances)

    def expected(self, rows: Array) -> Array:
        """The disturbances (g, c, q) that rows (n, r, q) are due to, with their sign turned."""
        pull = _summed(self.group, np.swapaxes(self.jacobian, 1, 2) @ rows)
        return np.linalg.solve(self.information, pull)

    def squares(self, rows: Array) -> tuple[Array, Array]:
        """Rows (n, r, q) without the disturbance, and what it costs itself, (g, c, q): the sum of
        the squares of both is what its elimination leaves."""
        shift = self.expected(rows)
        return rows - self.jacobian @ shift[self.group], shift / np.sqrt(self.variances)[:, None]

    @property
    def log_determinant(self) -> float:
        """ln |I + J Σ Jᵀ| over all groups."""
        whole = np.linalg.slogdet(self.information)[1].sum()
        return float(whole + len(self.information) * np.sum(np.log(self.variances)))


@dataclass(frozen=True, slots=True)
class PictureJitter:
    """The disturbances of one camera's and robot's pictures (n): `picture` of each, and `floor` of
    those at one node, where that is another; `nodes` (g,): whose what `eliminated` returns is;
    `jacobian` (n, 2K, 6); `jitter`."""

    nodes: np.ndarray
    jacobian: Array
    jitter: Jitter
    picture: _Shared
    floor: _Shared | None

    @classmethod
    def of(cls, problem: Problem, batch: Batch, state: State) -> "PictureJitter | None":
        """The jitter of a batch; None where it has none."""
        if batch.jitter is None:
            return None
        by_base = base_jacobian(problem, batch, state)
        return cls.by(by_base.reshape(len(by_base), -1, 6), batch.nodes, batch.jitter)

    @classmethod
    def by(cls, jacobian: Array, nodes: np.ndarray, jitter: Jitter) -> Self:
        """From the corners' derivatives (n, 2K, 6) at nodes (n,)."""
        each, group = np.unique(nodes, return_inverse=True)
        every, variances = np.arange(len(nodes)), jitter.variances
        if not jitter.is_floor or len(each) == len(nodes):
            return cls(nodes, jacobian, jitter, _Shared.of(every, jacobian, variances), None)
        picture = _Shared.of(every, jacobian[..., :3], variances[:3])
        tilted = np.concatenate(picture.squares(jacobian[..., 3:]), axis=1)
        return cls(each, jacobian, jitter, picture, _Shared.of(group, tilted, variances[3:]))

    def compensated(self, residual: Array) -> Array:
        """What is left of residuals (n, 2K) without the disturbances that they are due to."""
        left = residual[..., None]
        if self.floor is not None:
            tilt = self.floor.expected(np.concatenate(self.picture.squares(left), axis=1))
            left = left - self.jacobian[..., 3:] @ tilt[self.floor.group]
        return self.picture.squares(left)[0][..., 0]

    def eliminated(self, jacobian: Array, residual: Array) -> tuple[Array, Array, float]:
        """Hessian (g, q, q), gradient (g, q) and cost at each node by other unknowns, from the
        corners' derivatives (n, 2K, q) and residuals (n, 2K), without the disturbances."""
        rows = np.concatenate([jacobian, residual[..., None]], axis=-1)
        rows = np.concatenate(self.picture.squares(rows), axis=1)
        if self.floor is None:
            square = np.swapaxes(rows, 1, 2) @ rows
        else:
            left, own = self.floor.squares(rows)
            square = _summed(self.floor.group, np.swapaxes(left, 1, 2) @ left)
            square += np.swapaxes(own, 1, 2) @ own
        return square[:, :-1, :-1], square[:, :-1, -1], float(np.sum(square[:, -1, -1]))

    @property
    def log_determinant(self) -> float:
        """ln |I + J Σ Jᵀ| over all pictures."""
        floor = 0.0 if self.floor is None else self.floor.log_determinant
        return self.picture.log_determinant + floor


def _summed(group: np.ndarray, rows: Array) -> Array:
    """Rows (n, …) added up by group, (g, …)."""
    total = np.zeros((int(group.max(initial=-1)) + 1, *rows.shape[1:]))
    np.add.at(total, group, rows)
    return total
