"""The extended Kalman filter: robots and cameras in one state, as the 2005 paper announced.

The state is an error about nominal values: each robot's last pose (x, y and heading where it is
planar), every camera, and where the site file gives them a prior sigma the cameras' time offsets
and the robots' odometry scales. After each update the error is added to the nominal values, about
which the filter is then relinearised (iterated: Bell and Cathey, «The iterated Kalman filter update
as a Gauss-Newton method», 1993). Errors of poses are left twists, which keeps the filter consistent
where the heading drifts (`pose_errors`, decision 0643).

A new camera enters with its full cross covariance: its first sighting, solved for the camera alone,
makes the camera's error a linear function of everything else's (Smith, Self and Cheeseman, 1990).
"""

from typing import Self

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.motion import both, odometry_step
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians, symmetric, turned_axes

from .filter_state import Innovation, ReadSighting
from .kalman_state import KalmanState, Part
from .pose_errors import disturbance_by_twist, twist_between, twist_by_disturbance
from .relative_pose import RelativeView
from .sequential import SequentialEstimator

_MOST_ITERATIONS = 5
# An iteration that moves nothing by more than this many of its sigmas is the last.
_SETTLED = 0.02


def extended_kalman_filter(data: DataSet) -> SequentialEstimator:
    """The estimator «ekf»."""
    return SequentialEstimator(data, KalmanFilterState.at_origin)


class KalmanFilterState(KalmanState, frozen=True):
    """See `FilterState`."""

    @classmethod
    def at_origin(cls, data: DataSet) -> "KalmanFilterState":
        """Before any sighting: the first robot where its odometry begins, or the known cameras;
        before odometry nothing."""
        filter_state = cls({}, {}, {}, {}, {}, {}, np.zeros((0, 0)))
        if data.known.poses:
            return filter_state.with_known_cameras(data) if data.has_odometry else filter_state
        robot = data.anchored_robot
        assert robot is not None  # no camera is known
        track = data.tracks[robot]
        if not len(track):
            return filter_state
        filter_state = filter_state.with_robot_priors(
            data, robot, track.odom_from_base[0], track.first_ns
        )
        d = len(track.tangent)
        return filter_state.with_part(("last", robot), np.zeros((d, d)))

    def advanced(self, data: DataSet, robot: str, stamp_ns: int) -> "KalmanFilterState":
        if stamp_ns <= self.stamps_ns[robot]:
            return self
        moments_ns = np.array([self.stamps_ns[robot], stamp_ns])
        motion = data.tracks[robot].motion(moments_ns, self.scales(robot))
        step = odometry_step(self.poses[robot], motion)
        part, tangent = self.columns["last", robot], self.tangents[robot]
        # A left twist of the start is the same twist of the end; only the motion's error is added.
        by_end = twist_by_disturbance(step.end)[np.ix_(tangent, tangent)]
        covariance = self.covariance.copy()
        if ("scales", robot) in self.columns:
            scales = self.columns["scales", robot]
            by_scales = by_end @ step.by_scales[tangent]
            covariance[part] += by_scales @ covariance[scales]
            covariance[:, part] += covariance[:, scales] @ by_scales.T
        by_motion = by_end @ step.by_motion[tangent]
        covariance[part, part] += by_motion @ motion.covariance[0] @ by_motion.T
        return replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            poses=self.poses | {robot: step.end},
            covariance=covariance,
        )

    # -- sightings --------------------------------------------------------------------------------

    def updated(
        self, data: DataSet, sighting: ReadSighting
    ) -> tuple["KalmanFilterState", Innovation] | None:
        """Iterate about where the sighting puts the robot, not where odometry does."""
        if sighting.places_robot:
            return self._with_robot(data, sighting)
        camera, robot = sighting.observation.camera, sighting.observation.robot
        error = np.zeros(len(self.covariance))
        twist = twist_between(self.poses[robot], sighting.map_from_base)
        error[self.columns["last", robot]] = twist[self.tangents[robot]]
        update = view = None
        for _ in range(_MOST_ITERATIONS):
            there = self.moved(error, cameras=[camera])
            view = there._view(data, sighting)
            if view is None:
                return None
            jacobian = there._jacobian(data, sighting, view)
            update = _Update.by(self.covariance, jacobian, view.residual - jacobian @ error)
            step, error = update.error - error, update.error
            if np.all(np.abs(step) <= _SETTLED * update.sigmas + 1e-9):
                break
        assert update is not None
        assert view is not None
        return self._followed(data, sighting, update, view)

    def _followed(
        self, data: DataSet, sighting: ReadSighting, update: "_Update", view: RelativeView
    ) -> tuple["KalmanFilterState", Innovation]:
        """The state after an update by a sighting, which `view` was before."""
        # A product with its own transpose is half the work, and symmetric to the last bit.
        covariance = update.gain @ update.gain.T
        np.subtract(self.covariance, covariance, out=covariance)
        after = replace(self.moved(update.error), covariance=covariance)
        rms_px = (after._view(data, sighting) or view).rms_px
        chi2, freedom = update.chi2, update.gain.shape[1]
        total, of_all = chi2 + view.left_over, freedom + view.freedom
        return after, Innovation(chi2, freedom, total, of_all, rms_px)

    def _with_robot(
        self, data: DataSet, sighting: ReadSighting
    ) -> tuple["KalmanFilterState", Innovation] | None:
        """Add a robot by its first sighting by a camera of the state."""
        robot, camera = sighting.observation.robot, sighting.observation.camera
        stamp_ns = sighting.observation.stamp_ns - to_ns(self.states[camera].time_offset_s)
        ready = self.with_robot_priors(data, robot, sighting.map_from_base, stamp_ns)
        return ready._entered(data, sighting, ("last", robot))

    def with_camera(
        self, data: DataSet, sighting: ReadSighting, camera: CameraState
    ) -> "tuple[KalmanFilterState, Innovation] | None":
        name, robot = sighting.observation.camera, sighting.observation.robot
        camera_from_base = camera.map_from_camera.inverse() @ sighting.map_from_base
        # Before any sighting its time offset is taken to be near zero.
        map_from_camera = self.poses[robot] @ camera_from_base.inverse()
        placed = CameraState(map_from_camera, data.lenses[name])
        return self.with_camera_priors(data, name, placed)._entered(data, sighting, ("pose", name))

    def _entered(
        self, data: DataSet, sighting: ReadSighting, part: Part
    ) -> tuple["KalmanFilterState", Innovation] | None:
        """Add a new part that this sighting alone determines, given everything else.

        The sighting's equations ρ + A δ + B ν = noise are rotated by B's full QR factorisation: the
        upper rows give the part ν from the rest δ, the lower ones, free of ν, update the rest.
        """
        count = len(self.tangents[part[1]]) if part[0] == "last" else 6
        ready = self.with_part(part, np.zeros((count, count)))
        view = ready._view(data, sighting)
        if view is None or not view.determines_pose:
            return None
        jacobian, new = ready._jacobian(data, sighting, view), ready.columns[part]
        basis, root = np.linalg.qr(jacobian[:, new], mode="complete")
        turned = basis.T @ jacobian
        turned[:, new] = 0.0
        residual, inverse = basis.T @ view.residual, np.linalg.inv(root[:count])
        by_rest, error = -inverse @ turned[:count], np.zeros(len(ready.covariance))
        error[new] = -inverse @ residual[:count]
        rows, covariance = by_rest @ ready.covariance, ready.covariance.copy()
        covariance[new], covariance[:, new] = rows, rows.T
        covariance[new, new] = rows @ by_rest.T + inverse @ inverse.T
        placed = replace(ready.moved(error), covariance=symmetric(covariance))
        update = _Update.by(placed.covariance, turned[count:], residual[count:])
        return placed._followed(data, sighting, update, view)

    # -- how a sighting follows the state ---------------------------------------------------------

    def _seen(self, data: DataSet, sighting: ReadSighting) -> tuple[Pose, Array]:
        """The robot's pose when it was seen, and its disturbance per second then, (6,).

        Its node is at the time that an earlier estimate of the camera's time offset gave.
        """
        camera, robot = sighting.observation.camera, sighting.observation.robot
        pose, node_ns = self.poses[robot], self.stamps_ns[robot]
        if ("offset", camera) not in self.columns:
            return pose, np.zeros(6)
        twist = data.tracks[robot].twists_about(np.array([node_ns]))[0]
        moving = turned_axes(pose.rotation) @ (twist * both(1 + self.scales(robot)))
        after_s = to_seconds(sighting.observation.stamp_ns - node_ns)
        return pose.disturbed(moving * (after_s - self.states[camera].time_offset_s)), moving

    def _view(self, data: DataSet, sighting: ReadSighting) -> RelativeView | None:
        camera = self.states[sighting.observation.camera]
        pose, _ = self._seen(data, sighting)
        return sighting.view(data, camera.lens, camera.map_from_camera.inverse() @ pose)

    def _jacobian(self, data: DataSet, sighting: ReadSighting, view: RelativeView) -> Array:
        """The derivative of the compressed residual by the whole error, (k, n)."""
        camera, robot = sighting.observation.camera, sighting.observation.robot
        map_from_camera = self.states[camera].map_from_camera
        pose, moving = self._seen(data, sighting)
        by_camera, by_base = relative_jacobians(map_from_camera, pose)
        by_camera, by_base = view.root @ by_camera, view.root @ by_base
        jacobian = np.zeros((len(view.residual), len(self.covariance)))
        jacobian[:, self.columns["pose", camera]] = by_camera @ disturbance_by_twist(
            map_from_camera
        )
        jacobian[:, self.columns["last", robot]] = (by_base @ disturbance_by_twist(pose))[
            :, self.tangents[robot]
        ]
        if ("offset", camera) in self.columns:
            # True time = stamp - offset: with a larger one the robot was seen earlier.
            jacobian[:, self.columns["offset", camera]] = -(by_base @ moving)[:, None]
        return jacobian


class _Update(Struct, frozen=True):
    """What equations say of an error that was zero with a covariance P (n, n): residual (k,) +
    J (k, n) · error = noise of unit variance. `error`, `sigmas`: (n,) after the update; `gain`:
    (n, k) by the innovation whitened by L of S = 1 + J P Jᵀ = L Lᵀ, of which `chi2` is the square
    (Kalman, 1960)."""

    error: Array
    sigmas: Array
    gain: Array
    chi2: float

    @classmethod
    def by(cls, covariance: Array, jacobian: Array, residual: Array) -> Self:
        """Raises LinAlgError where S is not positive definite."""
        near = np.flatnonzero(jacobian.any(axis=0))  # a sighting bears on few of a large state
        spread = covariance[:, near] @ jacobian[:, near].T
        root = np.linalg.cholesky(np.eye(len(residual)) + jacobian[:, near] @ spread[near])
        innovation = np.linalg.solve(root, -residual)
        gain = np.linalg.solve(root, spread.T).T
        sigmas = np.sqrt(np.abs(np.diagonal(covariance) - np.sum(gain**2, axis=1)))
        return cls(gain @ innovation, sigmas, gain, float(innovation @ innovation))
