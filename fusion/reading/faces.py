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
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

from .planar_pose import planar_poses, refined_poses
from .visibility import (
    Body,
    are_seen,
    body_of,
    by_reading,
    faces_of,
    outermost,
    pattern_from_base,
    ways_of,
)

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
    found = _of_view(observation.views[index], target, lens)
    if found is None:
        return None
    camera_from_base, own = found
    readings = np.zeros((len(own), len(observation.views)), dtype=int)
    is_possible = np.ones(len(own), dtype=bool)
    for order, view in enumerate(observation.views):
        if order == index:
            rms = reading_rms_px(view, target, lens, camera_from_base, own)
            readings[:, order] = own
        else:
            each = readings_rms_px(view, target, lens, camera_from_base)
            readings[:, order], rms = np.argmin(each, axis=1), np.min(each, axis=1)
        is_possible &= np.isfinite(rms)
    return _Reads(readings[is_possible], camera_from_base[is_possible])


def _of_view(view: View, target: Target, lens: CameraModel) -> tuple[Pose, np.ndarray] | None:
    """Every camera_from_base (b) that one view allows, and the index of the reading of each (b,);
    None where there is none."""
    poses, own, fits = [], [], {}
    for number, reading in enumerate(view.readings):
        face = target.faces[reading.face]
        pattern = (face.appearance, face.square, face.marker)
        if pattern not in fits:
            points = face_points(face, view.corners, is_turned=False)
            fits[pattern] = planar_poses(lens, points, view.pixels, view.sigma)
        poses += [fit.pose for fit in fits[pattern]]
        own += [number] * len(fits[pattern])
    if not poses:
        return None
    faces, is_turned = ways_of(view.readings)
    patterns = (faces + len(target.faces) * is_turned)[own]
    return Pose.stack(poses) @ pattern_from_base(target)[patterns], np.array(own)


def readings_rms_px(view: View, target: Target, lens: CameraModel, camera_from_base: Pose) -> Array:
    """`reading_rms_px` for poses (b) and each of a view's readings (r), (b, r)."""
    shape = len(camera_from_base), len(view.readings)
    poses, readings = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return reading_rms_px(view, target, lens, camera_from_base[poses], readings).reshape(shape)


def reading_rms_px(
    view: View, target: Target, lens: CameraModel, camera_from_base: Pose, readings: np.ndarray
) -> Array:
    """Reprojection RMS of a coordinate for poses (b), each with its own reading of a view (b,),
    pixels, (b,); infinite for a face that would be seen from behind or through another."""
    body = body_of(target)
    points = by_reading(view, body)[readings]
    optical = camera_from_base @ points
    ahead = np.all(optical[..., 2] > 1e-3, axis=-1)
    projected = lens.project(np.where(optical[..., 2:] > 1e-3, optical, [0.0, 0.0, 1.0]))
    rms = np.sqrt(np.mean((projected - view.pixels) ** 2, axis=(-1, -2)))
    few = points[:, outermost(view.pixels)]
    eyes = camera_from_base.inverse().translation
    is_counted = np.ones(few.shape[:2], dtype=bool)
    is_seen = are_seen(body, faces_of(view)[readings], few, is_counted, eyes)
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
    if not found:
        return kept
    poses = Pose.stack([candidate.camera_from_base for candidate in found])
    is_open = np.ones(len(found), dtype=bool)
    for row, candidate in enumerate(found):
        if is_open[row]:
            kept.append(candidate)
            is_read_alike = [other.readings == candidate.readings for other in found]
            is_open &= ~(are_same_pose(poses, candidate.camera_from_base) & is_read_alike)
    return kept


def is_same_pose(first: Pose, second: Pose) -> bool:
    """Whether two poses are the same solution."""
    return bool(are_same_pose(Pose.stack([first]), second)[0])


def are_same_pose(poses: Pose, other: Pose) -> np.ndarray:
    """Which of poses (n) are the same solution as another one, (n,) bool."""
    apart = np.linalg.norm(poses.translation - other.translation, axis=-1)
    cosine = np.einsum("nij,ij->n", poses.rotation, other.rotation)  # 1 + 2 cos(angle)
    return (apart < _SAME_PLACE_M) & (cosine > 1 + 2 * np.cos(_SAME_TURN_RAD))
