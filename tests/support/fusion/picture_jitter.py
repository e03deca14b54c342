"""The error that all corners of one picture share: the robot's deviation from its node.

A floor that tilts by a third of a degree or a mast that sways by a millimetre moves all corners of
a picture as one, so more corners do not average it away. With ε the disturbance of the robot in one
picture, of variances Σ, and J the corners' derivative by it, their covariance is I + J Σ Jᵀ. Its
inverse is I - J M⁻¹ Jᵀ with M = Σ⁻¹ + JᵀJ (Woodbury): ε is eliminated from each picture.

The corners are not linear in ε: what a tilt ε leaves at a distance d, ε²d, has the same sign in all
pictures, and does not average out. So the normal equations are those about the ε that fits best
by the picture's own variances (`PictureEquations` of the core).
"""

from typing import Any, Self, cast

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.prediction import batch_jacobian
from trigpoint.fusion.model.problem import Batch, Chain, Layout, Priors, Problem, State
from trigpoint.geometry.rotation import Array


class PictureJitter(Struct, frozen=True):
    """The disturbances of one camera's and robot's pictures (n): `jacobian` (n, 2K, 6), of their
    corners; `variances` (n, 6); `information` (n, 6, 6): M."""

    jacobian: Array
    variances: Array
    information: Array

    @classmethod
    def of(cls, batch: Batch, state: State) -> "PictureJitter | None":
        """The jitter of a batch; None where it has none."""
        if batch.jitter is None:
            return None
        by_base = base_jacobian(batch, state)
        return cls.by(by_base.reshape(len(by_base), -1, 6), batch.jitter[:, 0])

    @classmethod
    def by(cls, jacobian: Array, variances: Array) -> Self:
        """From the corners' derivatives (n, 2K, 6) and the disturbances' variances (n, 6)."""
        information = np.swapaxes(jacobian, 1, 2) @ jacobian
        information[:, range(6), range(6)] += 1 / variances
        return cls(jacobian, variances, information)

    def compensated(self, residual: Array) -> Array:
        """Residuals (n, 2K) less what the best-fitting disturbances explain of them."""
        return self._squares(residual[..., None])[0][..., 0]

    def rows(self, jacobian: Array, residual: Array) -> tuple[Array, Array]:
        """Jacobian (n, 2K + 6, q) and residual (n, 2K + 6), of unit noise, in other unknowns: the
        corners' (n, 2K, q) and (n, 2K) after the disturbances are eliminated."""
        rows = np.concatenate([jacobian, residual[..., None]], axis=-1)
        rows = np.concatenate(self._squares(rows), axis=1)
        return rows[..., :-1], rows[..., -1]

    def _squares(self, rows: Array) -> tuple[Array, Array]:
        """Rows (n, 2K, q) less the fitted disturbance, and the residual (n, 6, q) of its own prior:
        the sum of the squares of both is what its elimination leaves."""
        pull = np.swapaxes(self.jacobian, 1, 2) @ rows
        shift = np.linalg.solve(self.information, pull)
        return rows - self.jacobian @ shift, shift / np.sqrt(self.variances)[..., None]


def base_jacobian(batch: Batch, state: State) -> Array:
    """Weighted derivative (n, K, 2, 6) of a batch's residual by a disturbance of the robot's pose
    when it was seen, in the map's axes: that by a node in space which is there."""
    robot, camera, count = state.robots[batch.robot], batch.camera, len(batch.nodes)
    seen = robot.map_from_base[batch.nodes]
    if batch.carried is not None:
        seen = seen @ batch.carried.at(state.cameras[camera].offset_s(batch.since_epoch_s))
    there = replace(batch, nodes=np.arange(count), carried=None)
    none = cast(Any, None)
    chain = Chain(batch.robot, none, none, none, none, planar=False, is_anchored=False)
    layout = Layout({camera: np.arange(6)}, {}, {}, {}, {}, {}, 6)
    problem = Problem({batch.robot: chain}, (there,), Priors.none(), layout)
    robots = {batch.robot: replace(robot, map_from_base=seen)}
    return batch_jacobian(problem, there, State(state.cameras, robots))[0][..., :6]
