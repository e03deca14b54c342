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
from trigpoint.fusion.model.motion import odometry_step
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians, symmetric

from .filter_state import Innovation, ReadSighting, velocity
from .kalman_state import KalmanState, Part
from .pose_errors import disturbance_by_twist, twist_between, twist_by_disturbance
from .relative_pose import RelativeView, relative_view
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
        """Before any sighting: the first robot where its odometry begins, or the known cameras."""
        filter_state = cls({}, {}, {}, {}, {}, {}, np.zeros((0, 0)))
        if data.known.poses:
            return filter_state.with_known_cameras(data)
        robot = data.anchored_robot
        assert robot is not None  # no camera is known
        track = data.tracks[robot]
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
        """Iterate over the parts that the sighting bears on; the rest follows by its covariance."""
        if sighting.places_robot:
            return self._with_robot(data, sighting)
        parts = _parts_of(sighting)
        near = self.only(parts)
        # The first linearisation is where the sighting puts the robot, not where odometry does.
        error = near._error_at(sighting)
        update = view = jacobian = None
        for _ in range(_MOST_ITERATIONS):
            there = near.moved(error)
            view = there._view(data, sighting)
            if view is None:
                return None
            jacobian = there._jacobian(data, sighting, view)
            update = _Update.by(near.covariance, jacobian, view.residual - jacobian @ error)
            step, error = update.error - error, update.error
            if np.all(np.abs(step) <= _SETTLED * update.sigmas + 1e-9):
                break
        assert update is not None
        assert view is not None
        assert jacobian is not None
        after = self._followed(update, jacobian, self.of(parts))
        seen = after._view(data, sighting)
        return after, _innovation(seen, view, update.chi2, len(view.residual))

    def _followed(
        self, update: "_Update", jacobian: Array, columns: np.ndarray
    ) -> "KalmanFilterState":
        """The whole state after an update (k equations) of some of its columns."""
        gain = update.whitened_gain(self.covariance[:, columns] @ jacobian.T)
        # A product with its own transpose is half the work, and symmetric to the last bit.
        covariance = gain @ gain.T
        np.subtract(self.covariance, covariance, out=covariance)
        return replace(self.moved(gain @ update.innovation), covariance=covariance)

    def _error_at(self, sighting: ReadSighting) -> Array:
        """The error (n,) that puts the robot where the sighting does."""
        robot = sighting.observation.robot
        error = np.zeros(len(self.covariance))
        twist = twist_between(self.poses[robot], sighting.map_from_base)
        error[self.columns["last", robot]] = twist[self.tangents[robot]]
        return error

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
        rest = ready.of([other for other in _parts_of(sighting) if other != part])
        near = ready.only(_parts_of(sighting))
        jacobian = near._jacobian(data, sighting, view)
        new = near.columns[part]
        basis, root = np.linalg.qr(jacobian[:, new], mode="complete")
        turned = basis.T @ np.delete(jacobian, new, axis=1)
        residual, inverse = basis.T @ view.residual, np.linalg.inv(root[:count])
        placed = ready._placed(part, rest, -inverse @ turned[:count], -inverse @ residual[:count])
        placed.covariance[ready.columns[part], ready.columns[part]] += inverse @ inverse.T
        lower = len(residual) - count
        if lower == 0:
            return placed, _innovation(placed._view(data, sighting), view, 0.0, 0)
        prior = placed.covariance[np.ix_(rest, rest)]
        update = _Update.by(prior, turned[count:], residual[count:])
        after = placed._followed(update, turned[count:], rest)
        return after, _innovation(after._view(data, sighting), view, update.chi2, lower)

    def _placed(
        self, part: Part, rest: np.ndarray, by_rest: Array, error: Array
    ) -> "KalmanFilterState":
        """Set a part's error to `error` (k,) + by_rest (k, m) · that of some columns (m,)."""
        columns, covariance = self.columns[part], self.covariance.copy()
        whole = np.zeros(len(covariance))
        whole[columns] = error
        rows = by_rest @ covariance[rest]
        covariance[columns], covariance[:, columns] = rows, rows.T
        covariance[columns, columns] = rows[:, rest] @ by_rest.T
        return replace(self.moved(whole), covariance=symmetric(covariance))

    # -- how a sighting follows the state ---------------------------------------------------------

    def _seen(self, data: DataSet, sighting: ReadSighting) -> tuple[Pose, Array]:
        """The robot's pose when it was seen, and its disturbance per second then, (6,).

        Its node is at the time that an earlier estimate of the camera's time offset gave.
        """
        camera, robot = sighting.observation.camera, sighting.observation.robot
        pose, node_ns = self.poses[robot], self.stamps_ns[robot]
        if ("offset", camera) not in self.columns:
            return pose, np.zeros(6)
        moving = velocity(data.tracks[robot], pose, node_ns, self.scales(robot))
        after_s = to_seconds(sighting.observation.stamp_ns - node_ns)
        return pose.disturbed(moving * (after_s - self.states[camera].time_offset_s)), moving

    def _view(self, data: DataSet, sighting: ReadSighting) -> RelativeView | None:
        camera, robot = self.states[sighting.observation.camera], sighting.observation.robot
        pose, _ = self._seen(data, sighting)
        return relative_view(
            sighting.observation,
            data.targets[robot],
            camera.lens,
            camera.map_from_camera.inverse() @ pose,
            sighting.variances,
        )

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


def _parts_of(sighting: ReadSighting) -> list[Part]:
    """The parts of the error that a sighting bears on."""
    camera, robot = sighting.observation.camera, sighting.observation.robot
    return [("last", robot), ("pose", camera), ("offset", camera)]


class _Update(Struct, frozen=True):
    """What equations say of an error that was zero with a covariance P (m, m): residual (k,) +
    J (k, m) · error = noise of unit variance. `root`: L (k, k) of S = 1 + J P Jᵀ = L Lᵀ;
    `innovation`: (k,), whitened by it; `error`, `sigmas`: (m,) after the update (Kalman, 1960)."""

    root: Array
    innovation: Array
    error: Array
    sigmas: Array

    @classmethod
    def by(cls, covariance: Array, jacobian: Array, residual: Array) -> Self:
        """Raises LinAlgError where S is not positive definite."""
        spread = covariance @ jacobian.T
        root = np.linalg.cholesky(np.eye(len(residual)) + jacobian @ spread)
        innovation = np.linalg.solve(root, -residual)
        gain = np.linalg.solve(root, spread.T).T
        variances = np.diagonal(covariance) - np.sum(gain**2, axis=1)
        return cls(root, innovation, gain @ innovation, np.sqrt(np.abs(variances)))

    def whitened_gain(self, spread: Array) -> Array:
        """The gain by the whitened innovation, (n, k), of unknowns of which P Jᵀ is (n, k)."""
        return np.linalg.solve(self.root, spread.T).T

    @property
    def chi2(self) -> float:
        return float(self.innovation @ self.innovation)


def _innovation(
    after: RelativeView | None, view: RelativeView, chi2: float, freedom: int
) -> Innovation:
    rms_px = after.rms_px if after is not None else view.rms_px
    return Innovation(chi2, freedom, chi2 + view.left_over, freedom + view.freedom, rms_px)
