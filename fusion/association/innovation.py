"""How far a sighting is from where everything else puts it."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from trigpoint.geometry.rotation import Array

from .events import Events


@dataclass(frozen=True, slots=True)
class Corners:
    """A view's weighted residual (k, 2), and its derivatives by the robot's pose (k, 2, 6) and by
    the unknowns (k, 2, q)."""

    residual: Array
    by_base: Array
    by_state: Array

    def without(self, wild: np.ndarray) -> Self:
        """Without its wild corners (k,)."""
        return replace(
            self,
            residual=self.residual[~wild],
            by_base=self.by_base[~wild],
            by_state=self.by_state[~wild],
        )


def innovation_excess(
    corners: Corners, covariance: Array, events: Events, jitter: Array | None, *, is_used: bool
) -> float:
    """νᵀS⁻¹ν + ln|S|, at most that of a board that may be anywhere: how improbable everything
    else makes the pose that a sighting shows by itself, over that of a wrong one: of a board
    anywhere, or of one that is off by any amount, small ones too. `jitter` (6,): variances by which
    the robot stands otherwise in its picture.

    `covariance`: of the unknowns, what the sighting says included where it `is_used`; then with
    P the pose's own covariance and H its derivative by the unknowns, what is left over has
    R = P - HΣHᵀ = P S⁻¹ P, and the innovation ν = S P⁻¹ times that.
    """
    flat = corners.by_base.reshape(-1, 6)
    try:
        own = np.linalg.inv(flat.T @ flat + np.diag(1 / events.room_variances))
        step = -own @ (flat.T @ corners.residual.reshape(-1))
        by_state = own @ (flat.T @ corners.by_state.reshape(len(flat), -1))
        if jitter is not None:
            own = own + np.diag(jitter)
        root = np.linalg.cholesky(own)
    except np.linalg.LinAlgError:
        # It shows no pose that could contradict.
        return -events.wrong_limit
    whitened = np.linalg.solve(root, by_state)
    values, vectors = np.linalg.eigh(whitened @ covariance @ whitened.T)
    pulled = vectors.T @ np.linalg.solve(root, step)
    spread = 2 * float(np.sum(np.log(np.diagonal(root))))
    if is_used:
        left = np.clip(1 - values, 1e-6, 1.0)
        spread -= float(np.sum(np.log(left)))
    else:
        left = 1 + np.maximum(values, 0.0)
        spread += float(np.sum(np.log(left)))
    chi2 = float(np.sum(pulled**2 / left))
    score = chi2 + min(spread, events.pose_score)
    return max(score - events.wrong_limit, chi2 - events.sighting_gate)
