"""The extended Kalman filter: robots and cameras in one state, as the 2005 paper announced.

The state is an error about nominal poses, in the contract's disturbances: each robot's last pose
(x, y and heading where it is planar), every camera, and where the site file gives them a prior
sigma the cameras' time offsets and the robots' odometry scales. After each update the error is put
into the nominal state, which is then linearised about anew (iterated: Bell and Cathey, «The
iterated Kalman filter update as a Gauss-Newton method», 1993).

A new camera enters with its full cross covariance: its first sighting, solved for the camera alone,
makes the camera's error a linear function of everything else's (Smith, Self and Cheeseman, 1990).
"""

from dataclasses import dataclass, replace

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from trigpoint.clock import to_seconds
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .belief import Sight, Surprise, carry, velocity
from .dataset import DataSet
from .estimator import CameraEstimate
from .filter import RobotEstimate
from .problem import CameraState
from .relative_view import RelativeView, relative_jacobians, relative_view
from .sequential import SequentialEstimator

_MOST_ITERATIONS = 4
# An iteration that moves nothing by more than this many of its sigmas is the last.
_SETTLED = 0.02
# A sighting determines a camera where the weakest direction is known at least this much, relative
# to the best known one.
_DETERMINED = 1e-7


def extended_kalman_filter(data: DataSet) -> SequentialEstimator:
    """The estimator «ekf»."""
    return SequentialEstimator(data, KalmanBelief.at_origin)


@dataclass(frozen=True, slots=True)
class KalmanBelief:
    """See `Belief`. `columns`: where each part of the error is in `covariance`, by kind and name;
    `tangents`: which of a robot's six disturbances are free."""

    stamps_ns: dict[str, int]
    poses: dict[str, Pose]
    tangents: dict[str, list[int]]
    scale_errors: dict[str, Array]
    states: dict[str, CameraState]
    columns: dict[tuple[str, str], slice]
    covariance: Array

    @classmethod
    def at_origin(cls, data: DataSet) -> "KalmanBelief":
        """Before any sighting: the first robot where its odometry begins, or the known cameras."""
        belief = cls({}, {}, {}, {}, {}, {}, np.zeros((0, 0)))
        if data.known.poses:
            joint = np.linalg.inv(data.known.information)
            for index, (name, pose) in enumerate(data.known.poses.items()):
                rows = slice(6 * index, 6 * index + 6)
                belief = belief._with_part(("pose", name), joint[rows, rows])
                state = CameraState(pose, data.lenses[name])
                belief = belief._with_camera_priors(data, name, state)
            every = belief._of([("pose", name) for name in data.known.poses])
            covariance = belief.covariance.copy()
            covariance[np.ix_(every, every)] = joint
            return replace(belief, covariance=covariance)
        robot = data.anchored_robot
        assert robot is not None  # no camera is known
        track = data.tracks[robot]
        belief = belief._with_robot_priors(data, robot, track.odom_from_base[0], track.first_ns)
        d = len(track.tangent)
        return belief._with_part(("last", robot), np.zeros((d, d)))

    # -- what is believed -------------------------------------------------------------------------

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.states)

    def camera(self, camera: str) -> CameraState:
        return self.states[camera]

    def estimate(self, camera: str) -> CameraEstimate:
        state, part = self.states[camera], self.columns["pose", camera]
        sigmas = np.sqrt(np.diagonal(self.covariance))
        offset_sigma = 0.0
        if ("offset", camera) in self.columns:
            offset_sigma = float(sigmas[self.columns["offset", camera]][0])
        return CameraEstimate(
            state.map_from_camera,
            self.covariance[part, part].copy(),
            state.lens,
            np.zeros(len(state.lens.parameters)),
            state.time_offset_s,
            offset_sigma,
        )

    def robot(self, robot: str) -> RobotEstimate:
        part, tangent = self.columns["last", robot], self.tangents[robot]
        full = np.zeros((6, 6))
        full[np.ix_(tangent, tangent)] = self.covariance[part, part]
        return RobotEstimate(self.stamps_ns[robot], self.poses[robot], full)

    def scales(self, robot: str) -> Array:
        return self.scale_errors.get(robot, np.zeros(2))

    def joint_covariance(self, cameras: list[str]) -> Array:
        every = self._of([("pose", name) for name in cameras])
        return self.covariance[np.ix_(every, every)]

    def particles(self, robot: str) -> None:  # noqa: ARG002 - it has none
        return None

    # -- odometry ---------------------------------------------------------------------------------

    def advanced(self, data: DataSet, robot: str, stamp_ns: int) -> "KalmanBelief":
        if stamp_ns <= self.stamps_ns[robot]:
            return self
        moments = np.array([self.stamps_ns[robot], stamp_ns])
        motion = data.tracks[robot].motion(moments, self.scales(robot))
        step = carry(self.poses[robot], motion)
        part, tangent = self.columns["last", robot], self.tangents[robot]
        size = len(self.covariance)
        transition, noise = np.eye(size), np.zeros((size, size))
        transition[part, part] = step.by_start[np.ix_(tangent, tangent)]
        if ("scales", robot) in self.columns:
            transition[part, self.columns["scales", robot]] = step.by_scales[tangent]
        spread = step.by_motion @ motion.covariance[0] @ step.by_motion.T
        noise[part, part] = spread[np.ix_(tangent, tangent)]
        kalman = self._kalman(1)
        kalman.F, kalman.Q = transition, noise
        kalman.predict()
        return replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            poses=self.poses | {robot: step.end},
            covariance=symmetric(kalman.P),
        )

    # -- sightings --------------------------------------------------------------------------------

    def updated(self, data: DataSet, sight: Sight) -> tuple["KalmanBelief", Surprise] | None:
        robot = sight.observation.robot
        if sight.is_tie:
            return self._tied(data, sight)
        # The first linearisation is where the sighting puts the robot, not where odometry does.
        error = np.zeros(len(self.covariance))
        apart = sight.map_from_base.difference(self.poses[robot])
        error[self.columns["last", robot]] = apart[self.tangents[robot]]
        kalman, view = self._kalman(1), None
        for _ in range(_MOST_ITERATIONS):
            there = self._moved(error)
            view = there._view(data, sight)
            if view is None:
                return None
            jacobian = there._jacobian(data, sight, view)
            kalman = self._kalman(len(view.residual))
            _update(kalman, jacobian, view.residual - jacobian @ error)
            step, error = kalman.x - error, kalman.x
            if np.all(np.abs(step) <= _SETTLED * np.sqrt(np.abs(np.diagonal(kalman.P))) + 1e-9):
                break
        assert view is not None
        after = replace(self._moved(error), covariance=symmetric(kalman.P))
        chi2 = float(kalman.mahalanobis) ** 2
        return after, _surprise(after._view(data, sight), view, chi2, len(view.residual))

    def _tied(self, data: DataSet, sight: Sight) -> tuple["KalmanBelief", Surprise] | None:
        """A robot enters by its first sighting by a camera of the state."""
        robot, camera = sight.observation.robot, sight.observation.camera
        stamp_ns = _true_ns(sight, self.states[camera])
        ready = self._with_robot_priors(data, robot, sight.map_from_base, stamp_ns)
        return ready._entered(data, sight, ("last", robot))

    def with_camera(
        self, data: DataSet, sight: Sight, camera: CameraState
    ) -> "tuple[KalmanBelief, Surprise] | None":
        name, robot = sight.observation.camera, sight.observation.robot
        camera_from_base = camera.map_from_camera.inverse() @ sight.map_from_base
        # What is known of its time offset before any sighting is that it is about nothing.
        map_from_camera = self.poses[robot] @ camera_from_base.inverse()
        placed = CameraState(map_from_camera, data.lenses[name])
        return self._with_camera_priors(data, name, placed)._entered(data, sight, ("pose", name))

    def _entered(
        self, data: DataSet, sight: Sight, part: tuple[str, str]
    ) -> tuple["KalmanBelief", Surprise] | None:
        """With a new part that this sighting alone determines, given everything else.

        The sighting's equations ρ + A δ + B ν = noise are turned by B's full factorisation: the
        upper rows give the part ν from the rest δ, the lower ones, free of ν, update the rest.
        """
        tangent = self.tangents[part[1]] if part[0] == "last" else list(range(6))
        ready = self._with_part(part, np.zeros((len(tangent), len(tangent))))
        view = ready._view(data, sight)
        if view is None:
            return None
        jacobian = ready._jacobian(data, sight, view)
        new = ready._of([part])
        basis, root = np.linalg.qr(jacobian[:, new], mode="complete")
        count = len(new)
        strength = np.linalg.svd(root[:count], compute_uv=False)
        if strength[-1] < _DETERMINED * strength[0]:
            return None
        rest = jacobian.copy()
        rest[:, new] = 0.0
        turned, residual = basis.T @ rest, basis.T @ view.residual
        inverse = np.linalg.inv(root[:count])
        follows = np.eye(len(ready.covariance))
        follows[new] = -inverse @ turned[:count]
        covariance = follows @ ready.covariance @ follows.T
        covariance[np.ix_(new, new)] += inverse @ inverse.T
        error = np.zeros(len(covariance))
        error[new] = -inverse @ residual[:count]
        after = replace(ready._moved(error), covariance=symmetric(covariance))
        lower = len(residual) - count
        if lower == 0:
            return after, _surprise(after._view(data, sight), view, 0.0, 0)
        kalman = after._kalman(lower)
        _update(kalman, turned[count:], residual[count:])
        chi2 = float(kalman.mahalanobis) ** 2
        after = replace(after._moved(kalman.x), covariance=symmetric(kalman.P))
        return after, _surprise(after._view(data, sight), view, chi2, lower)

    def _seen(self, data: DataSet, sight: Sight) -> tuple[Pose, Array]:
        """Where the robot was when it was seen, and its disturbance per second then, (6,).

        Its node stands where an earlier estimate of the camera's time offset put it.
        """
        camera, robot = sight.observation.camera, sight.observation.robot
        pose, node_ns = self.poses[robot], self.stamps_ns[robot]
        if ("offset", camera) not in self.columns:
            return pose, np.zeros(6)
        moving = velocity(data.tracks[robot], pose, node_ns, self.scales(robot))
        after_s = to_seconds(sight.observation.stamp_ns - node_ns)
        return pose.disturbed(moving * (after_s - self.states[camera].time_offset_s)), moving

    def _view(self, data: DataSet, sight: Sight) -> RelativeView | None:
        camera, robot = self.states[sight.observation.camera], sight.observation.robot
        pose, _ = self._seen(data, sight)
        camera_from_base = camera.map_from_camera.inverse() @ pose
        return relative_view(sight.observation, data.targets[robot], camera.lens, camera_from_base)

    def _jacobian(self, data: DataSet, sight: Sight, view: RelativeView) -> Array:
        """The compressed residual by the whole error, (k, n)."""
        camera, robot = sight.observation.camera, sight.observation.robot
        pose, moving = self._seen(data, sight)
        by_camera, by_base = relative_jacobians(self.states[camera].map_from_camera, pose)
        by_base = view.root @ by_base
        jacobian = np.zeros((len(view.residual), len(self.covariance)))
        jacobian[:, self.columns["pose", camera]] = view.root @ by_camera
        jacobian[:, self.columns["last", robot]] = by_base[:, self.tangents[robot]]
        if ("offset", camera) in self.columns:
            # True time = stamp - offset: a larger one looks at the robot earlier on its way.
            jacobian[:, self.columns["offset", camera]] = -(by_base @ moving)[:, None]
        return jacobian

    # -- the state's parts ------------------------------------------------------------------------

    def _with_camera_priors(self, data: DataSet, camera: str, state: CameraState) -> "KalmanBelief":
        config = data.site.cameras[camera]
        belief = replace(self, states=self.states | {camera: state})
        if config.time_offset_sigma > 0:
            variance = np.array([[config.time_offset_sigma**2]])
            belief = belief._with_part(("offset", camera), variance)
        return belief

    def _with_robot_priors(
        self, data: DataSet, robot: str, map_from_base: Pose, stamp_ns: int
    ) -> "KalmanBelief":
        track = data.tracks[robot]
        belief = replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            poses=self.poses | {robot: map_from_base},
            tangents=self.tangents | {robot: track.tangent},
            scale_errors={robot: np.zeros(2)} | self.scale_errors,
        )
        noise = data.site.robots[robot].odometry
        sigmas = np.array([noise.distance_scale, noise.heading_scale])
        if np.any(sigmas > 0) and ("scales", robot) not in self.columns:
            belief = belief._with_part(("scales", robot), np.diag(sigmas**2))
        return belief

    def _with_part(self, part: tuple[str, str], covariance: Array) -> "KalmanBelief":
        """With a part that is independent of the rest so far."""
        size, more = len(self.covariance), len(covariance)
        whole = np.zeros((size + more, size + more))
        whole[:size, :size], whole[size:, size:] = self.covariance, covariance
        columns = self.columns | {part: slice(size, size + more)}
        return replace(self, columns=columns, covariance=whole)

    def without_camera(self, camera: str) -> "KalmanBelief":
        states = {name: state for name, state in self.states.items() if name != camera}
        gone = [("pose", camera), ("offset", camera)]
        return replace(self, states=states)._without(gone)

    def without_robot(self, robot: str) -> "KalmanBelief":
        stamps = {name: stamp for name, stamp in self.stamps_ns.items() if name != robot}
        return replace(self, stamps_ns=stamps)._without([("last", robot)])

    def _without(self, parts: list[tuple[str, str]]) -> "KalmanBelief":
        """Without some parts: what is known of the rest stays as it is."""
        kept = [part for part in self.columns if part not in parts]
        every, columns, size = self._of(kept), {}, 0
        for part in kept:
            length = self.columns[part].stop - self.columns[part].start
            columns[part] = slice(size, size + length)
            size += length
        return replace(self, columns=columns, covariance=self.covariance[np.ix_(every, every)])

    def _of(self, parts: list[tuple[str, str]]) -> np.ndarray:
        every = np.arange(len(self.covariance))
        return np.concatenate([np.zeros(0, dtype=int), *[every[self.columns[p]] for p in parts]])

    def _moved(self, error: Array) -> "KalmanBelief":
        """The nominal state moved by an error."""
        poses, states, scales = dict(self.poses), dict(self.states), dict(self.scale_errors)
        for (kind, name), part in self.columns.items():
            if kind == "last":
                disturbance = np.zeros(6)
                disturbance[self.tangents[name]] = error[part]
                poses[name] = poses[name].moved(disturbance)
            elif kind == "pose":
                pose = states[name].map_from_camera.moved(error[part])
                states[name] = replace(states[name], map_from_camera=pose)
            elif kind == "offset":
                offset_s = states[name].time_offset_s + float(error[part][0])
                states[name] = replace(states[name], time_offset_s=offset_s)
            else:
                scales[name] = scales[name] + error[part]
        return replace(self, poses=poses, states=states, scale_errors=scales)

    def _kalman(self, measured: int) -> ExtendedKalmanFilter:
        """filterpy's filter over the error, which is zero now."""
        kalman = ExtendedKalmanFilter(dim_x=len(self.covariance), dim_z=measured)
        kalman.x, kalman.P = np.zeros(len(self.covariance)), self.covariance
        return kalman


def _update(kalman: ExtendedKalmanFilter, jacobian: Array, residual: Array) -> None:
    """Update by equations residual + jacobian · error = noise of unit variance."""
    kalman.R = np.eye(len(residual))
    kalman.update(
        np.zeros(len(residual)), lambda _: jacobian, lambda error: residual + jacobian @ error
    )


def _true_ns(sight: Sight, camera: CameraState) -> int:
    return sight.observation.stamp_ns - round(camera.time_offset_s * 1e9)


def _surprise(
    after: RelativeView | None, view: RelativeView, chi2: float, freedom: int
) -> Surprise:
    rms_px = after.rms_px if after is not None else view.rms_px
    return Surprise(chi2, freedom, chi2 + view.left_over, freedom + view.freedom, rms_px)
