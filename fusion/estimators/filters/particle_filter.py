"""The particle filter, the 2005 paper's estimator: the robots' poses by particles.

Each particle holds the robots' poses and, given those, every camera's own Gaussian estimate
(Rao-Blackwellised: Montemerlo et al., «FastSLAM», 2002). A new camera is placed along the paper's
chain, map ← robot ← face ← camera, in each particle for itself; when the robot meets a known camera
again, particles in which it stands where they expect it gain weight.

A pose is drawn as late as can be: while one camera sees the robot, that camera and the robot are
one Gaussian in each particle, and when the next one sees it the pose is drawn from what odometry
and both cameras say together (FastSLAM 2.0, 2003, draws at every sighting).

A revisit knows thousands of times more than the particles' spread, and would leave a handful of
them. It is taken in shares that leave half of them effective, with low-variance resampling after
each (`particle_resampling`, decision 0641).
"""

from dataclasses import dataclass, replace

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.motion import odometry_step
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians

from .filter_state import Innovation, ReadSighting
from .particle_resampling import effective_sample_size, largest_share, normalised
from .particles import PARTICLES, Particles, mean_pose, transposed
from .relative_pose import RelativeView, relative_view
from .sequential import SequentialEstimator

_MOST_SHARES = 200
_MOST_LINEARISATIONS = 3
# Weights as even as this say nothing: less than a hundredth of a sigma.
_ALIKE = 0.9999


def particle_filter(data: DataSet) -> SequentialEstimator:
    """The estimator «particle»."""
    return SequentialEstimator(data, ParticleFilterState.at_origin)


@dataclass(frozen=True, slots=True)
class _Terms:
    """A sighting in each of n particles: residual (n, k) of unit noise; its derivative (n, k, m) by
    the robot, its companion if it has one, and the camera; their covariance (n, m, m) together,
    and the innovation's (n, k, k)."""

    residual: Array
    jacobian: Array
    covariance: Array
    total: Array

    @property
    def log_likelihood(self) -> Array:
        """(n,), up to a constant."""
        solved = np.linalg.solve(self.total, self.residual[..., None])[..., 0]
        _, log_determinant = np.linalg.slogdet(self.total)
        return -0.5 * (np.sum(self.residual * solved, axis=1) + log_determinant)


@dataclass(frozen=True, slots=True)
class ParticleFilterState(Particles):
    """See `FilterState`."""

    @classmethod
    def at_origin(cls, data: DataSet) -> "ParticleFilterState":
        """Before any sighting: the first robot where its odometry begins, or the known cameras."""
        filter_state = cls(data.site.fusion.seed, 0, *({} for _ in range(10)))
        if data.known.poses:
            return filter_state._with_known(data)
        robot = data.anchored_robot
        assert robot is not None  # no camera is known
        track = data.tracks[robot]
        filter_state = filter_state.with_robot(data, robot, track.odom_from_base[0], track.first_ns)
        d = len(track.tangent)
        nothing = np.zeros((PARTICLES, d, d))
        return replace(filter_state, spreads=filter_state.spreads | {robot: nothing})

    def _with_known(self, data: DataSet) -> "ParticleFilterState":
        joint = np.linalg.inv(data.known.information)
        random = self.random()
        drawn = random.standard_normal((PARTICLES, len(joint))) @ np.linalg.cholesky(joint).T
        places = {}
        for index, (name, pose) in enumerate(data.known.poses.items()):
            places[name] = pose.repeated(PARTICLES).disturbed(drawn[:, 6 * index : 6 * index + 6])
        return replace(
            self,
            draws=self.draws + 1,
            places=places,
            covariances={name: np.zeros((PARTICLES, 6, 6)) for name in places},
            lenses={name: data.lenses[name] for name in places},
        )

    # -- odometry ---------------------------------------------------------------------------------

    def advanced(self, data: DataSet, robot: str, stamp_ns: int) -> "ParticleFilterState":
        """Each particle moved on by odometry; its noise is drawn when the next sighting comes."""
        if stamp_ns <= self.stamps_ns[robot]:
            return self
        mean_scales = self.scales(robot)
        moments_ns = np.array([self.stamps_ns[robot], stamp_ns])
        motion = data.tracks[robot].motion(moments_ns, mean_scales)
        step = odometry_step(self.poses[robot], motion)
        tangent = self.tangents[robot]
        free = np.ix_(range(PARTICLES), tangent, tangent)
        noise = (step.by_motion @ motion.covariance[0] @ transposed(step.by_motion))[free]
        by_start = step.by_start[free]
        end = step.end
        if robot in self.scale_errors:
            apart = self.scale_errors[robot] - mean_scales
            end = end.disturbed((step.by_scales @ apart[..., None])[..., 0])
        return replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            poses=self.poses | {robot: end},
            spreads=self.spreads
            | {robot: by_start @ self.spreads[robot] @ transposed(by_start) + noise},
            crossed={n: by_start @ c if n == robot else c for n, c in self.crossed.items()},
        )

    # -- sightings --------------------------------------------------------------------------------

    def updated(
        self, data: DataSet, sighting: ReadSighting
    ) -> tuple["ParticleFilterState", Innovation] | None:
        robot, camera = sighting.observation.robot, sighting.observation.camera
        filter_state = self.with_drawn(
            n for n, c in self.companions.items() if c == camera and n != robot
        )
        if sighting.places_robot:
            stamp_ns = sighting.observation.stamp_ns
            filter_state = filter_state.with_robot(data, robot, sighting.map_from_base, stamp_ns)
        view = filter_state._linearised(data, sighting)
        if view is None:
            return None
        chi2 = filter_state._innovation_chi2(view, robot, camera)
        freedom = len(view.residual) - (
            len(filter_state.tangents[robot]) if sighting.places_robot else 0
        )
        filter_state = filter_state._weighted(view, robot, camera)._improved(view, robot, camera)
        after = filter_state._view(data, sighting, filter_state._relative(robot, camera))
        rms_px = after.rms_px if after is not None else view.rms_px
        total = chi2 + view.left_over
        return filter_state, Innovation(chi2, freedom, total, freedom + view.freedom, rms_px)

    def with_camera(
        self, data: DataSet, sighting: ReadSighting, camera: CameraState
    ) -> tuple["ParticleFilterState", Innovation] | None:
        """Each particle's pose is drawn, and the camera placed by it, with the sighting's error."""
        robot, name = sighting.observation.robot, sighting.observation.camera
        camera_from_base = camera.map_from_camera.inverse() @ sighting.map_from_base
        target = data.targets[robot]
        view = relative_view(sighting.observation, target, camera.lens, camera_from_base)
        if view is None or not view.determines_pose:
            return None
        filter_state = self.with_drawn([robot])
        pose = filter_state.poses[robot]
        place = pose @ camera_from_base.inverse()
        by_camera, _ = relative_jacobians(place, pose)
        inverse = np.linalg.inv(view.root @ by_camera)
        filter_state = replace(
            filter_state,
            places=filter_state.places | {name: place.disturbed(-inverse @ view.residual)},
            covariances=filter_state.covariances | {name: inverse @ transposed(inverse)},
            lenses=filter_state.lenses | {name: camera.lens},
            companions=filter_state.companions | {robot: name},
            crossed=filter_state.crossed
            | {robot: np.zeros((PARTICLES, len(filter_state.tangents[robot]), 6))},
        )
        return filter_state, Innovation(0.0, 0, view.left_over, view.freedom, view.rms_px)

    def _relative(self, robot: str, camera: str) -> Pose:
        """camera_from_base by the mean camera and robot."""
        map_from_camera = mean_pose(self.places[camera])
        return map_from_camera.inverse() @ mean_pose(self.poses[robot])

    def _view(
        self, data: DataSet, sighting: ReadSighting, camera_from_base: Pose
    ) -> RelativeView | None:
        observation = sighting.observation
        lens = self.lenses[observation.camera]
        return relative_view(observation, data.targets[observation.robot], lens, camera_from_base)

    def _linearised(self, data: DataSet, sighting: ReadSighting) -> RelativeView | None:
        """The sighting about the camera_from_base that it and the particles say together."""
        robot, camera = sighting.observation.robot, sighting.observation.camera
        place = mean_pose(self.places[camera])
        view = self._view(data, sighting, place.inverse() @ sighting.map_from_base)
        for _ in range(_MOST_LINEARISATIONS - 1):
            if view is None or len(view.root) < 6:
                return None
            mean, covariance = self._expected(view, robot, camera)
            # d = mean + e, |residual + root d|² + eᵀ covariance⁻¹ e is least at:
            gain = covariance @ view.root.T
            gain = gain @ np.linalg.inv(view.root @ gain + np.eye(len(view.root)))
            best = mean - gain @ (view.residual + view.root @ mean)
            view = self._view(data, sighting, view.camera_from_base.disturbed(best))
        return view

    def _expected(self, view: RelativeView, robot: str, camera: str) -> tuple[Array, Array]:
        """Mean (6,) and covariance (6, 6) of the disturbance of the view's camera_from_base."""
        place, pose = self.places[camera], self.poses[robot]
        apart = (place.inverse() @ pose).difference(view.camera_from_base)
        mean, covariance = apart.mean(axis=0), np.cov(apart.T, bias=True)
        jacobian = self._jacobian(np.eye(6), robot, camera)
        within = jacobian @ self.together(robot, self._group(robot, camera))
        within = within @ transposed(jacobian)
        return mean, covariance + within.mean(axis=0)

    def _group(self, robot: str, camera: str) -> list[str]:
        """The cameras that a sighting moves in a particle: the robot's companion and this one."""
        companion = self.companions.get(robot)
        return [camera] if companion in (None, camera) else [companion, camera]

    def _jacobian(self, root: Array, robot: str, camera: str) -> Array:
        """root · camera_from_base's disturbance by the robot's and the group's, (n, k, m)."""
        by_camera, by_base = relative_jacobians(self.places[camera], self.poses[robot])
        parts = [root @ by_base[..., self.tangents[robot]]]
        parts += [np.zeros((PARTICLES, len(root), 6))] * (len(self._group(robot, camera)) - 1)
        return np.concatenate([*parts, root @ by_camera], axis=-1)

    def _innovation_chi2(self, view: RelativeView, robot: str, camera: str) -> float:
        """χ² of the innovation, for all particles together as one Gaussian."""
        mean, covariance = self._expected(view, robot, camera)
        residual = view.residual + view.root @ mean
        total = view.root @ covariance @ view.root.T + np.eye(len(residual))
        return float(residual @ np.linalg.solve(total, residual))

    def _terms(self, view: RelativeView, robot: str, camera: str) -> _Terms:
        relative = self.places[camera].inverse() @ self.poses[robot]
        apart = relative.difference(view.camera_from_base)
        jacobian = self._jacobian(view.root, robot, camera)
        covariance = self.together(robot, self._group(robot, camera))
        total = jacobian @ covariance @ transposed(jacobian) + np.eye(len(view.residual))
        return _Terms(view.residual + apart @ view.root.T, jacobian, covariance, total)

    def _weighted(self, view: RelativeView, robot: str, camera: str) -> "ParticleFilterState":
        """Particles by how well they expect the sighting, in shares that keep half effective."""
        filter_state, left = self, 1.0
        for _ in range(_MOST_SHARES):
            terms = filter_state._terms(view, robot, camera)
            log_likelihood = terms.log_likelihood
            share = largest_share(log_likelihood, left)
            weights = normalised(share * log_likelihood)
            if effective_sample_size(weights) < _ALIKE * PARTICLES:
                filter_state = filter_state.resampled(terms.residual, weights)
            left -= share
            if left <= 0:
                return filter_state
        raise ValueError("no particle is near what is seen")

    def _improved(self, view: RelativeView, robot: str, camera: str) -> "ParticleFilterState":
        """Each particle's Gaussians by the sighting; where another camera saw the robot before,
        its pose is drawn, after which the two know nothing of each other."""
        terms, group = self._terms(view, robot, camera), self._group(robot, camera)
        gain = terms.covariance @ transposed(terms.jacobian) @ np.linalg.inv(terms.total)
        step = -(gain @ terms.residual[..., None])[..., 0]
        keep = np.eye(gain.shape[1]) - gain @ terms.jacobian
        better = keep @ terms.covariance @ transposed(keep) + gain @ transposed(gain)
        filter_state = self.moved(robot, group, step, better)
        return filter_state.drawn_from(robot, group, better) if len(group) > 1 else filter_state
