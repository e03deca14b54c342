"""The innovation of a sighting: how far it is from where everything else predicts it."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from trigpoint.fusion.solver.picture_jitter import PictureJitter
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .events import Events

_REAL = np.float64
_INNOVATION = Kernel(
    "tp_innovation",
    In(_REAL, ("k", 12)),
    In(_REAL, ("k", 2)),
    In(_REAL, ("k", "s")),
    In(np.bool_, ("k",)),
    In(_REAL, ("q", "q")),
    In(_REAL, (6,)),
    int,
    float,
    Out(_REAL, (2,)),
)


@dataclass(frozen=True, slots=True)
class Corners:
    """The weighted residual (k, 2) of a view's corners, and its derivatives by the robot's pose
    (k, 2, 6) and by the unknowns (k, 2, q)."""

    residual: Array
    by_base: Array
    by_state: Array


@dataclass(frozen=True, slots=True)
class Stood:
    """The disturbance of the robot's pose about its node in each picture (n), estimated from all
    corners that are used; through it the views of one picture constrain each other.

    `shift` (n, 6): its mean; `own` (n, 6, 6): its covariance given the unknowns; `by_state`
    (n, 6, q): its derivative by the unknowns.
    """

    shift: Array
    own: Array
    by_state: Array

    @classmethod
    def of(cls, jitter: PictureJitter, by_state: Array, residual: Array) -> Self:
        """Estimate the disturbances from the corners that are used: their derivatives `by_state`
        (n, 2K, q) and `residual` (n, 2K)."""
        own = np.linalg.inv(jitter.information)
        pull = -own @ np.swapaxes(jitter.jacobian, 1, 2)
        return cls((pull @ residual[..., None])[..., 0], own, pull @ by_state)

    def beside(self, row: int, corners: Corners, covariance: Array) -> tuple[Corners, Array]:
        """Return a view's corners with the disturbance in its picture (`row`) as six more unknowns,
        and the joint covariance of all of them."""
        by, shift = self.by_state[row], self.shift[row]
        across = by @ covariance
        joint = np.block([[covariance, across.T], [across, self.own[row] + across @ by.T]])
        return Corners(
            corners.residual + corners.by_base @ shift,
            corners.by_base,
            np.concatenate([corners.by_state, corners.by_base], axis=-1),
        ), joint


def innovation_excess(
    corners: Corners,
    wild: np.ndarray,
    covariance: Array,
    events: Events,
    *,
    is_used: bool,
    rest: float,
) -> float:
    """Return by how much a sighting is less probable than a wrong one, given everything else:
    νᵀS⁻¹ν + ln|S| of the pose that it shows by itself, with ln|S| at most that of a board that may
    be anywhere, over the score of a wrong one (`Events.excess`).

    `wild` (k,): the corners that do not count; `rest`: the χ² by which the state may still be off
    its minimum; where a sighting determines something nearly alone, that must not count as a
    contradiction.
    `covariance`: Σ of the unknowns, which includes the sighting itself if it `is_used`. Then, with
    P the pose's own covariance and H its derivative by the unknowns, the residual has the
    covariance R = P - HΣHᵀ = P S⁻¹ P, and the innovation ν is S P⁻¹ times the residual.
    """
    found = np.empty(2)
    count = len(corners.residual)
    is_determined = _INNOVATION(
        corners.by_base.reshape(count, 12),
        np.ascontiguousarray(corners.residual),
        np.ascontiguousarray(corners.by_state).reshape(count, -1),
        wild,
        np.ascontiguousarray(covariance),
        events.room_variances,
        is_used,
        rest,
        found,
    )
    # What determines no pose cannot contradict anything.
    return float(events.excess(*found.tolist())) if is_determined else -events.wrong_limit
