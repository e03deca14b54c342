"""The state of the extended Kalman filter: nominal values, and the error about them."""

from collections.abc import Iterable
from typing import Self

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .pose_errors import disturbance_by_twist, twist_by_disturbance, twisted

Part = tuple[str, str]
"""A part of the error by kind and name: «pose» of a camera (6) and its time «offset» (1, seconds),
«last» of a robot (its free ones of 6) and its odometry's «scales» (2)."""


class KalmanState(Struct, frozen=True):
    """Robots at their last nodes, cameras, and the error's covariance (n, n); immutable.

    The error of a pose is its left twist (`pose_errors`). `columns`: where each part is in
    `covariance`; `tangents`: which of the six components of a robot's error are free.
    """

    stamps_ns: dict[str, int]
    poses: dict[str, Pose]
    tangents: dict[str, list[int]]
    scale_errors: dict[str, Array]
    states: dict[str, CameraState]
    columns: dict[Part, slice]
    covariance: Array

    # -- the estimate -----------------------------------------------------------------------------

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.states)

    def camera(self, camera: str) -> CameraState:
        return self.states[camera]

    def estimate(self, camera: str) -> CameraEstimate:
        state, offset = self.states[camera], self.of([("offset", camera)])
        return CameraEstimate(
            state.map_from_camera,
            self.joint_covariance([camera]),
            state.lens,
            np.zeros(len(state.lens.parameters)),
            state.time_offset_s,
            float(np.sqrt(self.covariance[offset, offset].sum())),
        )

    def robot(self, robot: str) -> RobotEstimate:
        tangent, part = self.tangents[robot], self.columns["last", robot]
        by_twist = disturbance_by_twist(self.poses[robot])[np.ix_(tangent, tangent)]
        full = np.zeros((6, 6))
        full[np.ix_(tangent, tangent)] = by_twist @ self.covariance[part, part] @ by_twist.T
        return RobotEstimate(self.stamps_ns[robot], self.poses[robot], full)

    def scales(self, robot: str) -> Array:
        return self.scale_errors.get(robot, np.zeros(2))

    def joint_covariance(self, cameras: list[str]) -> Array:
        every = self.of([("pose", name) for name in cameras])
        joint = self.covariance[np.ix_(every, every)]
        for index, name in enumerate(cameras):
            rows = slice(6 * index, 6 * index + 6)
            by_twist = disturbance_by_twist(self.states[name].map_from_camera)
            _turn(joint, rows, by_twist)
        return joint

    def particles(self, robot: str) -> None:  # noqa: ARG002 - it has none
        return None

    # -- the error's parts ------------------------------------------------------------------------

    def of(self, parts: list[Part]) -> np.ndarray:
        """The columns of these parts, as far as they exist, (m,)."""
        every = np.arange(len(self.covariance))
        here = [every[self.columns[part]] for part in parts if part in self.columns]
        return np.concatenate([np.zeros(0, dtype=int), *here])

    def only(self, parts: list[Part]) -> Self:
        """The marginal of these parts of the error."""
        kept, columns, size = [part for part in parts if part in self.columns], {}, 0
        for part in kept:
            length = self.columns[part].stop - self.columns[part].start
            columns[part] = slice(size, size + length)
            size += length
        every = self.of(kept)
        return replace(self, columns=columns, covariance=self.covariance[np.ix_(every, every)])

    def with_part(self, part: Part, covariance: Array) -> Self:
        """With a new part that is uncorrelated with the rest."""
        size, more = len(self.covariance), len(covariance)
        whole = np.zeros((size + more, size + more))
        whole[:size, :size], whole[size:, size:] = self.covariance, covariance
        columns = self.columns | {part: slice(size, size + more)}
        return replace(self, columns=columns, covariance=whole)

    def with_known_cameras(self, data: DataSet) -> Self:
        """With the cameras of an earlier network, with their joint covariance."""
        state, joint = self, data.known_at_start.covariance
        for index, (name, pose) in enumerate(data.known.poses.items()):
            rows = slice(6 * index, 6 * index + 6)
            _turn(joint, rows, twist_by_disturbance(pose))
            state = state.with_camera_priors(data, name, CameraState(pose, data.lenses[name]))
            state = state.with_part(("pose", name), np.zeros((6, 6)))
        every = state.of([("pose", name) for name in data.known.poses])
        state.covariance[np.ix_(every, every)] = joint
        return state

    def with_camera_priors(self, data: DataSet, camera: str, state: CameraState) -> Self:
        """With a camera's nominal values, and its time offset where that is estimated."""
        after = replace(self, states=self.states | {camera: state})
        sigma_s = data.site.cameras[data.site_camera(camera)].time_offset_sigma
        if sigma_s > 0:
            return after.with_part(("offset", camera), np.array([[sigma_s**2]]))
        return after

    def with_robot_priors(
        self, data: DataSet, robot: str, map_from_base: Pose, stamp_ns: int
    ) -> Self:
        """With a robot's nominal values, and its odometry's scales where those are estimated."""
        after = replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            poses=self.poses | {robot: map_from_base},
            tangents=self.tangents | {robot: data.tracks[robot].tangent},
            scale_errors={robot: np.zeros(2)} | self.scale_errors,
        )
        noise = data.site.robots[robot].odometry
        sigmas = np.array([noise.distance_scale, noise.heading_scale])
        if np.any(sigmas > 0) and ("scales", robot) not in self.columns:
            return after.with_part(("scales", robot), np.diag(sigmas**2))
        return after

    def without_robot(self, robot: str) -> Self:
        stamps = {name: stamp for name, stamp in self.stamps_ns.items() if name != robot}
        kept = [part for part in self.columns if part != ("last", robot)]
        return replace(self, stamps_ns=stamps).only(kept)

    def spread(self, covariances: dict[str, Array]) -> Self:
        whole = self.covariance.copy()
        for camera, covariance in covariances.items():
            part = self.columns["pose", camera]
            by_disturbance = twist_by_disturbance(self.states[camera].map_from_camera)
            whole[part, part] += by_disturbance @ covariance @ by_disturbance.T
        return replace(self, covariance=whole)

    # -- the error goes into the nominal values ---------------------------------------------------

    def moved(self, error: Array, *, cameras: Iterable[str] | None = None) -> Self:
        """The nominal values moved by an error (n,); of cameras all, or some.

        The covariance is left as it is: transforming each pose's twist by its own correction would
        make the error that all poses share differ between them, and so appear observable.
        """
        poses, cameras = dict(self.poses), self.states if cameras is None else cameras
        states = self._moved_cameras(error, cameras)
        scales = dict(self.scale_errors)
        for (kind, name), part in self.columns.items():
            if kind == "last":
                poses[name] = twisted(poses[name], self._twist(name, error[part]))
            elif kind == "offset":
                offset_s = states[name].time_offset_s + float(error[part][0])
                states[name] = replace(states[name], time_offset_s=offset_s)
            elif kind == "scales":
                scales[name] = scales[name] + error[part]
        return replace(self, poses=poses, states=states, scale_errors=scales)

    def _moved_cameras(self, error: Array, cameras: Iterable[str]) -> dict[str, CameraState]:
        """These cameras' poses moved all at once: there may be a hundred."""
        parts = {name: self.columns["pose", name] for name in cameras}
        if not parts:
            return dict(self.states)
        twists = np.stack([error[part] for part in parts.values()])
        before = Pose.stack([self.states[name].map_from_camera for name in parts])
        after = twisted(before, twists)
        return self.states | {
            name: replace(self.states[name], map_from_camera=after[index])
            for index, name in enumerate(parts)
        }

    def _twist(self, robot: str, free: Array) -> Array:
        twist = np.zeros(6)
        twist[self.tangents[robot]] = free
        return twist


def _turn(covariance: Array, rows: slice, jacobian: Array) -> None:
    """Transform some rows and columns of a covariance to other coordinates, in place."""
    covariance[rows] = jacobian @ covariance[rows]
    covariance[:, rows] = covariance[:, rows] @ jacobian.T
