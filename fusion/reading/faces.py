"""Which face a picture shows, which way up, and the relative pose of camera and robot.

Every reading of every view and both solutions of every plane are candidates until the evidence
decides between them.
"""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.observations import Observation, Reading
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Target

from .views import BODY, VIEWS, body_tables, patterns, view_tables

_SAME_PLACE_M = 0.05
_SAME_TURN_RAD = 0.05
_REAL = np.float64
_CANDIDATES = Kernel(
    "tp_candidates",
    *(In(_REAL, ("p",)), *BODY, In(np.int64, ("f",)), *VIEWS),
    *(Out(np.int64, ("b", "views")), Out(_REAL, ("b", 12)), Out(_REAL, ("b",))),
)


class Candidate(Struct, frozen=True):
    """One interpretation of an observation: readings, camera_from_base and its RMS in pixels."""

    readings: tuple[Reading, ...]
    camera_from_base: Pose
    rms_px: float


def candidates(
    observation: Observation, target: Target, lens: CameraModel
) -> tuple[Candidate, ...]:
    """All interpretations of a single observation, best first."""
    views = observation.views
    # Each reading of one view at both poses of its plane.
    most = 2 * max((len(view.readings) for view in views), default=0)
    numbers, rows = np.empty((most, len(views)), dtype=np.int64), np.empty((most, 12))
    rms = np.empty(most)
    count = _CANDIDATES(
        *(lens.parameters, *body_tables(target), patterns(target)),
        *(*view_tables(views), numbers, rows, rms),
    )
    return tuple(
        Candidate(
            tuple(view.readings[number] for view, number in zip(views, chosen, strict=True)),
            Pose.from_rows(row),
            each,
        )
        for chosen, row, each in zip(
            numbers[:count].tolist(), rows[:count], rms[:count].tolist(), strict=True
        )
    )


def pixels_of(observation: Observation) -> tuple[Array, Array]:
    """All pixels (n, 2) of an observation and their sigmas (n,)."""
    return np.concatenate([view.pixels for view in observation.views]), observation.sigmas


def is_same_pose(first: Pose, second: Pose) -> bool:
    """Whether two poses are the same solution."""
    return bool(are_same_pose(Pose.stack([first]), second)[0])


def are_same_pose(poses: Pose, other: Pose) -> np.ndarray:
    """Which of poses (n) are the same solution as another one, (n,) bool; (…) of any that
    broadcast."""
    apart = np.linalg.norm(poses.translation - other.translation, axis=-1)
    cosine = np.einsum("...ij,...ij->...", poses.rotation, other.rotation)  # 1 + 2 cos(angle)
    return (apart < _SAME_PLACE_M) & (cosine > 1 + 2 * np.cos(_SAME_TURN_RAD))
