"""Which face a picture shows, which way up, and the relative pose of camera and robot.

Every reading of every view and both solutions of every plane are candidates until the evidence
decides between them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trigpoint.fusion.model.observations import (
    Observation,
    Reading,
    View,
    face_points,
    observation_of,
)
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Target

from .planar_pose import planar_poses, refined_poses
from .visibility import Body, body_of, by_reading, can_be_seen, faces_of, outermost

# The largest reprojection RMS of a candidate, pixels. It is generous, since the lens may still be a
# nominal one.
_WORST_PX = 20.0
# The number of observations whose candidates are cached.
_MOST_KEPT = 1024
_SAME_PLACE_M = 0.05
_SAME_TURN_RAD = 0.05


@dataclass(frozen=True, slots=True)
class Candidate:
    """One interpretation of an observation: readings, camera_from_base and its RMS in pixels."""

    readings: tuple[Reading, ...]
    camera_from_base: Pose
    rms_px: float


@dataclass(frozen=True, slots=True)
class _Reads:
    """Interpretations of an observation before refinement: `readings` (b, views), indices into each
    view's; `camera_from_base` (b)."""

    readings: np.ndarray
    camera_from_base: Pose


def candidates(
    observation: Observation, target: Target, lens: CameraModel
) -> tuple[Candidate, ...]:
    """All interpretations of a single observation, best first."""
    return _candidates(observation.views, target, lens)


@lru_cache(maxsize=_MOST_KEPT)
def _candidates(
    views: tuple[View, ...], target: Target, lens: CameraModel
) -> tuple[Candidate, ...]:
    """`candidates`, cached: they depend on nothing else, and pictures are read repeatedly."""
    observation = observation_of("", "", 0, views)
    for index in range(len(views)):
        reads = _by_view(observation, index, target, lens)
        found = _refined(observation, target, lens, reads) if reads is not None else []
        if found:  # the other views took part already
            return tuple(_distinct(sorted(found, key=lambda candidate: candidate.rms_px)))
    return ()


def _by_view(
    observation: Observation, index: int, target: Target, lens: CameraModel
) -> _Reads | None:
    """For every reading of one view, the readings of the others that fit best with it."""
    poses, own = _of_view(observation.views[index], target, lens)
    if not poses:
        return None
    camera_from_base = Pose.stack(poses)
    readings = np.zeros((len(own), len(observation.views)), dtype=int)
    is_possible = np.ones(len(own), dtype=bool)
    for order, view in enumerate(observation.views):
        rms = readings_rms_px(view, target, lens, camera_from_base)
        readings[:, order] = own if order == index else np.argmin(rms, axis=1)
        is_possible &= np.isfinite(rms[np.arange(len(own)), readings[:, order]])
    return _Reads(readings[is_possible], camera_from_base[is_possible])


def _of_view(view: View, target: Target, lens: CameraModel) -> tuple[list[Pose], list[int]]:
    """Every camera_from_base that one view allows, and the index of the reading of each."""
    poses, own = [], []
    fits = {}
    face_from_base = body_of(target).face_from_base
    for number, reading in enumerate(view.readings):
        face = target.faces[reading.face]
        pattern = (face.appearance, face.square, face.marker)
        if pattern not in fits:
            points = face_points(face, view.corners, is_turned=False)
            fits[pattern] = planar_poses(lens, points, view.pixels, view.sigma)
        from_base = face_from_base[reading.face]
        if reading.is_turned:
            from_base = _half_turn(face) @ from_base
        for fit in fits[pattern]:
            poses.append(fit.pose @ from_base)
            own.append(number)
    return poses, own


def _half_turn(face: Face) -> Pose:
    """face_from_turned_face: the pose of the pattern when it is read from its other end."""
    return Pose(so3.exp([0.0, 0.0, np.pi]), face.corners[-1])


def readings_rms_px(view: View, target: Target, lens: CameraModel, camera_from_base: Pose) -> Array:
    """Reprojection RMS of a coordinate for poses (b) and each of a view's readings, pixels, (b, r);
    infinite for a face that would be seen from behind or through another."""
    body = body_of(target)
    points = by_reading(view, body)
    optical = (camera_from_base @ points.reshape(-1, 3)).reshape(-1, *points.shape)
    ahead = np.all(optical[..., 2] > 1e-3, axis=-1)
    projected = lens.project(np.where(optical[..., 2:] > 1e-3, optical, [0.0, 0.0, 1.0]))
    rms = np.sqrt(np.mean((projected - view.pixels) ** 2, axis=(-1, -2)))
    few = points[:, outermost(view.pixels)]
    eye = camera_from_base.inverse().translation
    is_seen = can_be_seen(body, faces_of(view)[None], few[None], eye[:, None])[:, 0]
    return np.where(ahead & is_seen, rms, np.inf)


def corners_of(observation: Observation, body: Body, readings: np.ndarray) -> Array:
    """All corners (b, n, 3) of an observation in the base frame for several readings (b, views)."""
    parts = [
        by_reading(view, body)[readings[:, order]] for order, view in enumerate(observation.views)
    ]
    return np.concatenate(parts, axis=1)


def pixels_of(observation: Observation) -> tuple[Array, Array]:
    """All pixels (n, 2) of an observation and their sigmas (n,)."""
    return np.concatenate([view.pixels for view in observation.views]), observation.sigmas


def _refined(
    observation: Observation, target: Target, lens: CameraModel, reads: _Reads
) -> list[Candidate]:
    """The combinations that fit, each at its pose of least reprojection error over all views."""
    if not len(reads.readings):
        return []
    points = corners_of(observation, body_of(target), reads.readings)
    pixels, sigma = pixels_of(observation)
    fits = refined_poses(lens, reads.camera_from_base, points, pixels, sigma)
    weight = float(np.mean(1 / sigma))
    found = []
    for chosen, fit in zip(reads.readings, fits, strict=True):
        if fit is not None and fit.rms / weight < _WORST_PX:
            views = zip(observation.views, chosen, strict=True)
            readings = tuple(view.readings[number] for view, number in views)
            found.append(Candidate(readings, fit.pose, fit.rms / weight))
    return found


def _distinct(found: list[Candidate]) -> list[Candidate]:
    kept: list[Candidate] = []
    for candidate in found:
        if not any(
            candidate.readings == other.readings
            and is_same_pose(candidate.camera_from_base, other.camera_from_base)
            for other in kept
        ):
            kept.append(candidate)
    return kept


def is_same_pose(first: Pose, second: Pose) -> bool:
    """Whether two poses are the same solution."""
    return bool(are_same_pose(Pose.stack([first]), second)[0])


def are_same_pose(poses: Pose, other: Pose) -> np.ndarray:
    """Which of poses (n) are the same solution as another one, (n,) bool."""
    apart = np.linalg.norm(poses.translation - other.translation, axis=-1)
    cosine = np.einsum("nij,ij->n", poses.rotation, other.rotation)  # 1 + 2 cos(angle)
    return (apart < _SAME_PLACE_M) & (cosine > 1 + 2 * np.cos(_SAME_TURN_RAD))
