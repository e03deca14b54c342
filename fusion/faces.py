"""Which face a picture shows, which way up, and where that puts the camera or the robot.

Nothing is guessed: every reading of every view and both solutions of every plane are candidates
until the evidence decides between them.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.pose import angle_between
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face, Target

from .observations import (
    Observation,
    Points,
    Reading,
    View,
    base_from_faces,
    face_points,
    points_of,
)
from .planar_pose import planar_poses, refined_pose

# A candidate whose reprojection is worse than this many pixels is no candidate. It is generous,
# since the lens may still be a nominal one.
_WORST_PX = 20.0
_SAME_PLACE_M = 0.05
_SAME_TURN_RAD = 0.05


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way to understand an observation: readings, camera_from_base and its RMS in pixels."""

    readings: tuple[Reading, ...]
    camera_from_base: Pose
    rms_px: float


def candidates(observation: Observation, target: Target, lens: CameraModel) -> list[Candidate]:
    """Every way to understand one observation by itself, best first."""
    found: list[Candidate] = []
    base_from_face = base_from_faces(target)
    for index, view in enumerate(observation.views):
        for reading, camera_from_base in _of_view(view, target, base_from_face, lens):
            readings = _read_others(
                observation, target, lens, camera_from_base, fixed={index: reading}
            )
            refined = _refined(observation, target, lens, camera_from_base, readings)
            if refined is not None and refined.rms_px < _WORST_PX:
                found.append(refined)
        if found and len(observation.views) > 1:
            break  # the other views took part already
    found.sort(key=lambda candidate: candidate.rms_px)
    return _distinct(found)


def _of_view(
    view: View, target: Target, base_from_face: Pose, lens: CameraModel
) -> list[tuple[Reading, Pose]]:
    """Every reading of one view with the camera_from_base that it gives."""
    found = []
    fits = {}
    for reading in view.readings:
        face = target.faces[reading.face]
        if face.appearance not in fits:
            points = face_points(face, view.corners, is_turned=False)
            fits[face.appearance] = planar_poses(lens, points, view.pixels, view.sigma)
        for fit in fits[face.appearance]:
            camera_from_face = fit.pose @ _half_turn(face) if reading.is_turned else fit.pose
            found.append((reading, camera_from_face @ base_from_face[reading.face].inverse()))
    return found


def _half_turn(face: Face) -> Pose:
    """face_from_turned face: the pattern read from its other end."""
    return Pose(so3.exp([0.0, 0.0, np.pi]), face.corners[-1])


def _read_others(
    observation: Observation,
    target: Target,
    lens: CameraModel,
    camera_from_base: Pose,
    *,
    fixed: dict[int, Reading],
) -> tuple[Reading, ...]:
    """For each view the reading that fits a pose best, but for the fixed ones."""
    return tuple(
        fixed.get(index) or best_reading(view, target, lens, camera_from_base)[0]
        for index, view in enumerate(observation.views)
    )


def best_reading(
    view: View, target: Target, lens: CameraModel, camera_from_base: Pose
) -> tuple[Reading, float, float]:
    """The reading of least RMS (pixels) for a pose, its RMS, and that of the next best."""
    scored = sorted(
        ((_rms_px(view, target, lens, camera_from_base, r), i) for i, r in enumerate(view.readings))
    )
    second = scored[1][0] if len(scored) > 1 else np.inf
    return view.readings[scored[0][1]], scored[0][0], second


def _rms_px(
    view: View, target: Target, lens: CameraModel, camera_from_base: Pose, reading: Reading
) -> float:
    """RMS of a coordinate, pixels; a face that is seen from behind fits nothing."""
    face = target.faces[reading.face]
    points = face_points(face, view.corners, is_turned=reading.is_turned)
    camera_from_face = camera_from_base @ face.base_from_face
    optical = camera_from_face @ points
    # z of the face points into the board, so away from whoever sees its front.
    if np.any(optical[:, 2] < 1e-3) or camera_from_face.rotation[:, 2] @ optical[0] < 0:
        return np.inf
    return float(np.sqrt(np.mean((lens.project(optical) - view.pixels) ** 2)))


def _refined(
    observation: Observation,
    target: Target,
    lens: CameraModel,
    start: Pose,
    readings: tuple[Reading, ...],
) -> Candidate | None:
    points = points_of(observation.read_as(readings), target)
    weights = points.weights
    fit = refined_pose(
        lens, start, points.in_base(base_from_faces(target)), points.pixels, 1 / weights
    )
    if fit is None:
        return None
    return Candidate(readings, fit.pose, fit.rms / float(np.mean(weights)))


def _distinct(found: list[Candidate]) -> list[Candidate]:
    kept: list[Candidate] = []
    for candidate in found:
        if not any(
            is_same_pose(candidate.camera_from_base, other.camera_from_base)
            and candidate.readings == other.readings
            for other in kept
        ):
            kept.append(candidate)
    return kept


def is_same_pose(first: Pose, second: Pose) -> bool:
    """Whether two poses are the same solution."""
    apart = np.linalg.norm(first.translation - second.translation)
    return bool(apart < _SAME_PLACE_M and angle_between(first, second) < _SAME_TURN_RAD)


def mean_cost(
    map_from_camera: Pose,
    looks: "list[Look]",
    lens: CameraModel,
) -> Array:
    """How badly camera poses (n) fit many observations: the mean over their views of the least
    mean-square reprojection error, pixels², each capped, (n,)."""
    total = np.zeros(len(map_from_camera))
    views = 0
    for look in looks:
        camera_from_base = map_from_camera.inverse() @ look.map_from_base
        for readings in look.readings:
            views += 1
            costs = [_capped(lens, camera_from_base, points, pixels) for points, pixels in readings]
            total += np.min(costs, axis=0)
    return total / max(views, 1)


@dataclass(frozen=True, slots=True)
class Look:
    """An observation made ready for `mean_cost`: for each view and each of its readings a few
    corners in the base frame (k, 3) and their pixels (k, 2)."""

    map_from_base: Pose
    readings: tuple[tuple[tuple[Array, Array], ...], ...]


def look_of(observation: Observation, target: Target, map_from_base: Pose) -> Look:
    """A look at an observation, at its outermost corners alone."""
    views = []
    for view in observation.views:
        few = _outermost(view.pixels)
        views.append(
            tuple(
                (_in_base(target.faces[r.face], view.corners[few], r), view.pixels[few])
                for r in view.readings
            )
        )
    return Look(map_from_base, tuple(views))


def _in_base(face: Face, corners: np.ndarray, reading: Reading) -> Array:
    return face.base_from_face @ face_points(face, corners, is_turned=reading.is_turned)


def _outermost(pixels: Array) -> np.ndarray:
    """Indices of the corners that reach furthest in four directions."""
    u, v = pixels.T
    return np.unique([np.argmin(u + v), np.argmax(u + v), np.argmin(u - v), np.argmax(u - v)])


def _capped(lens: CameraModel, camera_from_base: Pose, points: Array, pixels: Array) -> Array:
    optical = camera_from_base @ points
    ahead = np.all(optical[..., 2] > 1e-2, axis=-1)
    projected = lens.project(np.where(optical[..., 2:] > 1e-2, optical, [0.0, 0.0, 1.0]))
    square = np.mean((projected - pixels) ** 2, axis=(-1, -2))
    return np.where(ahead, np.minimum(square, _WORST_PX**2), _WORST_PX**2)


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where a robot stands before a located camera; `cost`: χ² with the prior's; `margin`: how much
    worse the next reading is."""

    map_from_base: Pose
    readings: tuple[Reading, ...]
    cost: float
    margin: float


@dataclass(frozen=True, slots=True)
class PosePrior:
    """What is known of map_from_base before a look: covariance (6, 6) of its disturbance."""

    map_from_base: Pose
    covariance: Array


def align(
    observation: Observation,
    target: Target,
    lens: CameraModel,
    map_from_camera: Pose,
    *,
    tangent: list[int],
    prior: PosePrior | None,
    extra_sigma_px: float,
) -> Alignment | None:
    """The reading and robot pose that fit a located camera's observation and the prior best.

    `extra_sigma_px`: what the camera's own uncertainty adds to the corners'.
    """
    starts = [
        (candidate.readings, map_from_camera @ candidate.camera_from_base)
        for candidate in candidates(observation, target, lens)
    ]
    if prior is not None:
        camera_from_base = map_from_camera.inverse() @ prior.map_from_base
        readings = _read_others(observation, target, lens, camera_from_base, fixed={})
        starts.append((readings, prior.map_from_base))
    scored: list[tuple[float, tuple[Reading, ...], Pose]] = []
    for readings, start in starts:
        points = points_of(observation.read_as(readings), target)
        posed = _aligned(
            points,
            target,
            lens,
            map_from_camera,
            _flattened(start, tangent),
            tangent,
            prior,
            extra_sigma_px,
        )
        if posed is not None:
            scored.append((posed[1], readings, posed[0]))
    if not scored:
        return None
    scored.sort(key=lambda item: item[0])
    cost, readings, pose = scored[0]
    others = [other for other, r, _ in scored if r != readings]
    return Alignment(pose, readings, cost, min(others, default=np.inf) - cost)


def _flattened(pose: Pose, tangent: list[int]) -> Pose:
    """The pose in the plane, where the robot moves in it."""
    if len(tangent) == 6:
        return pose
    x, y, _ = pose.translation
    return Pose.planar(x, y, pose.heading)


def _aligned(
    points: Points,
    target: Target,
    lens: CameraModel,
    map_from_camera: Pose,
    start: Pose,
    tangent: list[int],
    prior: PosePrior | None,
    extra_sigma_px: float,
) -> tuple[Pose, float] | None:
    """Gauss-Newton over the robot's pose; the pose and its cost, None where it diverges."""
    in_base = points.in_base(base_from_faces(target))
    weights = 1 / np.sqrt(1 / points.weights**2 + extra_sigma_px**2)
    rotation = map_from_camera.rotation
    information = np.zeros((len(tangent), len(tangent)))
    if prior is not None:
        information = np.linalg.inv(prior.covariance[np.ix_(tangent, tangent)])
    pose, cost = start, np.inf
    for _ in range(12):
        arm = in_base @ pose.rotation.T
        optical = (arm + pose.translation - map_from_camera.translation) @ rotation
        if np.any(optical[:, 2] < 1e-3):
            return None
        pixels, by_point, _ = lens.project_jacobians(optical)
        residual = ((pixels - points.pixels) * weights[:, None]).reshape(-1)
        if not np.all(np.isfinite(residual)):
            return None
        by_map = by_point @ rotation.T
        jacobian = np.concatenate([by_map, -by_map @ so3.hat(arm)], axis=-1)[..., tangent]
        jacobian = (jacobian * weights[:, None, None]).reshape(-1, len(tangent))
        hessian = jacobian.T @ jacobian + information
        gradient = jacobian.T @ residual
        cost = float(residual @ residual)
        if prior is not None:
            apart = pose.difference(prior.map_from_base)[tangent]
            gradient = gradient + information @ apart
            cost += float(apart @ information @ apart)
        disturbance = np.zeros(6)
        disturbance[tangent] = -np.linalg.lstsq(hessian, gradient, rcond=1e-13)[0]
        if np.abs(disturbance).max() < 1e-6:
            break
        pose = pose.disturbed(disturbance)
    return (pose, cost) if np.isfinite(cost) else None
