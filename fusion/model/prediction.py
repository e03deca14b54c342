"""The residuals of sightings and of odometry at a state, and their derivatives.

Every pose is disturbed by the contract's convention: t' = t + δt, R' = Exp(δθ) R in the parent's
axes.
"""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians

from .motion import Motion
from .problem import Batch, Problem, State
from .projection import before_camera, by_disturbance


def batch_residual(batch: Batch, state: State, disturbance: Array | None = None) -> Array:
    """`batch_jacobian`'s residual alone, (n, K, 2); with a disturbance (n, 6) of the robot's pose
    when it was seen, in the map's axes."""
    camera = state.cameras[batch.camera]
    scene = _scene(batch, state, disturbance)
    return (camera.lens.project(scene.optical) - batch.pixels) * batch.weights[..., None]


def batch_jacobian(problem: Problem, batch: Batch, state: State) -> tuple[Array, Array, np.ndarray]:
    """Weighted Jacobian (n, K, 2, d + q), residual (n, K, 2) and dense columns (q,) of a batch.

    Residual = (projection - pixel)/sigma. The first d columns are the node's; the dense ones begin
    with the camera's pose.
    """
    return _jacobian(problem, batch, state, _scene(batch, state))[:3]


def batch_jacobians(
    problem: Problem, batch: Batch, state: State
) -> tuple[Array, Array, np.ndarray, Array]:
    """`batch_jacobian` and `base_jacobian` of one batch."""
    scene = _scene(batch, state)
    jacobian, residual, columns, by_map = _jacobian(problem, batch, state, scene)
    return jacobian, residual, columns, by_disturbance(by_map, scene.in_seen_axes)


def _jacobian(
    problem: Problem, batch: Batch, state: State, scene: "_Scene"
) -> tuple[Array, Array, np.ndarray, Array]:
    """`batch_jacobian`, and the derivative (n, K, 2, 3) by a corner's position, map axes."""
    camera, robot = state.cameras[batch.camera], state.robots[batch.robot]
    chain, layout = problem.chains[batch.robot], problem.layout
    weights = batch.weights[..., None]
    parts: list[Array] = []
    columns = [layout.pose[batch.camera]]
    if batch.camera in layout.lens:
        pixels, by_optical, by_lens = camera.lens.project_jacobians(scene.optical)
        parts.append(by_lens * weights[..., None])
        columns.append(layout.lens[batch.camera])
    else:
        pixels, by_optical = camera.lens.project_by_point(scene.optical)
    residual = (pixels - batch.pixels) * weights
    by_optical *= weights[..., None]
    by_map = _rotated(by_optical, camera.map_from_camera.rotation.T)
    if scene.twist is not None:
        speed = (scene.twist.reshape(-1, 2, 3) @ np.swapaxes(scene.seen.rotation, 1, 2))[:, :, None]
        by_time = speed[:, 0] + np.cross(speed[:, 1], scene.in_seen_axes)
        by_offset = -by_map @ by_time[..., None]
        parts.append(by_offset * _offset_and_drift(batch.since_epoch_s))
        columns.append(layout.time_offset[batch.camera])
    if batch.robot in layout.faces:
        by_base = by_map @ scene.seen.rotation[:, None]
        by_face = by_disturbance(by_base, scene.in_face_axes)
        count = len(robot.base_from_face)
        mine = batch.faces[..., None] == np.arange(count)
        parts.append(
            (by_face[..., None, :] * mine[..., None, :, None]).reshape(*by_face.shape[:3], -1)
        )
        columns.append(layout.faces[batch.robot])
    by_node = by_disturbance(by_map, scene.arm, chain.tangent)
    by_camera = by_disturbance(-by_map, scene.from_camera)
    jacobian = np.concatenate([by_node, by_camera, *parts], axis=-1)
    return jacobian, residual, np.concatenate(columns), by_map


def base_jacobian(batch: Batch, state: State) -> Array:
    """Weighted derivative (n, K, 2, 6) of `batch_residual` by a disturbance of the robot's pose
    when it was seen, in the map's axes."""
    camera = state.cameras[batch.camera]
    scene = _scene(batch, state)
    by_optical = camera.lens.project_by_point(scene.optical)[1] * batch.weights[..., None, None]
    by_map = _rotated(by_optical, camera.map_from_camera.rotation.T)
    return by_disturbance(by_map, scene.in_seen_axes)


@dataclass(frozen=True, slots=True)
class _Scene:
    """A batch's corners (n, K, 3) at a state: from the face's origin, in the base's axes; from the
    robot as it was seen (`seen`), from its node (`arm`) and from the camera, in the map's axes; and
    in the optical frame. `twist` (n, 6): the robot's, where the time offset is estimated."""

    in_face_axes: Array
    in_seen_axes: Array
    arm: Array
    from_camera: Array
    optical: Array
    seen: Pose
    twist: Array | None


def _scene(batch: Batch, state: State, disturbance: Array | None = None) -> _Scene:
    camera, robot = state.cameras[batch.camera], state.robots[batch.robot]
    base_from_face = robot.base_from_face[batch.faces]
    in_face_axes = (base_from_face.rotation @ batch.face_points[..., None])[..., 0]
    in_base = in_face_axes + base_from_face.translation
    node = robot.map_from_base[batch.nodes]
    seen, twist = node, None
    if batch.carried is not None:
        seen = node @ batch.carried.at(camera.offset_s(batch.since_epoch_s))
        twist = batch.carried.twists
    if disturbance is not None:
        turned = so3.exp(disturbance[:, 3:]) @ seen.rotation
        seen = Pose(turned, seen.translation + disturbance[:, :3])
    in_seen_axes = in_base @ np.swapaxes(seen.rotation, 1, 2)
    arm = in_seen_axes
    if seen is not node:
        arm = in_seen_axes + (seen.translation - node.translation)[:, None]
    from_camera = arm + (node.translation - camera.map_from_camera.translation)[:, None]
    optical = _rotated(from_camera, camera.map_from_camera.rotation)
    optical = before_camera(optical)
    optical[..., 2] = np.where(batch.weights > 0, optical[..., 2], 1.0)
    return _Scene(in_face_axes, in_seen_axes, arm, from_camera, optical, seen, twist)


def _rotated(rows: Array, matrix: Array) -> Array:
    """Rows (…, 3) times one matrix, in one product; numpy would make many small ones."""
    return (rows.reshape(-1, 3) @ matrix).reshape(rows.shape)


def _offset_and_drift(since_epoch_s: Array) -> Array:
    """Derivative (n, 1, 1, 2) of the time offset at each stamp by a camera's offset and drift."""
    return np.stack([np.ones_like(since_epoch_s), since_epoch_s], axis=-1)[:, None, None]


@dataclass(frozen=True, slots=True)
class OdometryTerms:
    """Whitened residual (n, d) between consecutive nodes, and its derivatives."""

    residual: Array
    by_earlier: Array
    by_later: Array
    by_scale: Array


def odometry_terms(earlier: Pose, later: Pose, motion: Motion, tangent: list[int]) -> OdometryTerms:
    """Odometry's residual: t = R_iᵀ(t_j - t_i) - Δt, r = Log(R_iᵀ R_j ΔRᵀ), whitened.

    A disturbance of R_iᵀ R_j turns r by J_l⁻¹(r) (Solà et al.), one of ΔR by -J_r⁻¹(r), where
    J_r(r) = J_l(-r).
    """
    residual = (earlier.inverse() @ later).difference(motion.earlier_from_later)
    turn = residual[:, 3:]
    by_earlier, by_later = relative_jacobians(earlier, later)
    inverse = np.linalg.inv(so3.left_jacobian(turn))
    turning = inverse @ by_later[:, 3:, 3:]
    by_earlier[:, 3:, 3:], by_later[:, 3:, 3:] = -turning, turning
    by_scale = -motion.by_scale
    by_scale[:, 3:] = np.swapaxes(inverse, 1, 2) @ by_scale[:, 3:]  # J_l(-r) = J_l(r)ᵀ
    free = np.ix_(range(len(residual)), tangent, tangent)
    whitening = np.linalg.inv(np.linalg.cholesky(motion.covariance[free]))
    return OdometryTerms(
        (whitening @ residual[:, tangent, None])[..., 0],
        whitening @ by_earlier[free],
        whitening @ by_later[free],
        whitening @ by_scale[:, tangent],
    )
