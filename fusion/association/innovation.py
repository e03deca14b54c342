"""How far a sighting is from where everything else puts it."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from trigpoint.fusion.solver.picture_jitter import PictureJitter
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


@dataclass(frozen=True, slots=True)
class Stood:
    """How robots stood otherwise in pictures (n) than their nodes say, by all that is used of them:
    `shift` (n, 6), its covariance `own` (n, 6, 6) where the unknowns are known, and its derivative
    by those, `by_state` (n, 6, q). So views of one picture say of each other where that was."""

    shift: Array
    own: Array
    by_state: Array

    @classmethod
    def of(cls, jitter: PictureJitter, by_state: Array, residual: Array) -> Self:
        """`by_state` (n, 2K, q) and `residual` (n, 2K) of what is used."""
        own = np.linalg.inv(jitter.information)
        pull = -own @ np.swapaxes(jitter.jacobian, 1, 2)
        return cls((pull @ residual[..., None])[..., 0], own, pull @ by_state)

    def beside(self, row: int, corners: Corners, covariance: Array) -> tuple[Corners, Array]:
        """A view's corners in a picture with that as six more unknowns, and the covariance of all
        of them."""
        by, shift = self.by_state[row], self.shift[row]
        across = by @ covariance
        joint = np.block([[covariance, across.T], [across, self.own[row] + across @ by.T]])
        return Corners(
            corners.residual + corners.by_base @ shift,
            corners.by_base,
            np.concatenate([corners.by_state, corners.by_base], axis=-1),
        ), joint


def innovation_excess(
    corners: Corners, covariance: Array, events: Events, *, is_used: bool, rest: float
) -> float:
    """νᵀS⁻¹ν + ln|S|, at most that of a board that may be anywhere: how improbable everything
    else makes the pose that a sighting shows by itself, over that of a wrong one: of a board
    anywhere, or of one that is off by any amount, small ones too.

    `rest`: so much χ² the state may still be from its minimum; where a sighting says nearly alone
    where something is, that is no contradiction.
    `covariance`: of the unknowns, what the sighting says included where it `is_used`; then with
    P the pose's own covariance and H its derivative by the unknowns, what is left over has
    R = P - HΣHᵀ = P S⁻¹ P, and the innovation ν = S P⁻¹ times that.
    """
    flat = corners.by_base.reshape(-1, 6)
    try:
        own = np.linalg.inv(flat.T @ flat + np.diag(1 / events.room_variances))
        step = -own @ (flat.T @ corners.residual.reshape(-1))
        by_state = own @ (flat.T @ corners.by_state.reshape(len(flat), -1))
        root = np.linalg.cholesky(own)
    except np.linalg.LinAlgError:
        # It shows no pose that could contradict.
        return -events.wrong_limit
    whitened = np.linalg.solve(root, by_state)
    values, vectors = np.linalg.eigh(whitened @ covariance @ whitened.T)
    pulled = np.maximum(np.abs(vectors.T @ np.linalg.solve(root, step)) - np.sqrt(rest), 0.0)
    spread = 2 * float(np.sum(np.log(np.diagonal(root))))
    if is_used:
        left = np.clip(1 - values, 1e-6, 1.0)
        spread -= float(np.sum(np.log(left)))
    else:
        left = 1 + np.maximum(values, 0.0)
        spread += float(np.sum(np.log(left)))
    chi2 = float(np.sum(pulled**2 / left))
    return float(events.excess(chi2, spread))
