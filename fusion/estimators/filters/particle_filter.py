"""The particle filter, the 2005 paper's estimator: the robots' poses by particles.

Each particle holds the robots' poses and, given those, every camera's own Gaussian estimate
(Rao-Blackwellised: Montemerlo et al., «FastSLAM», 2002). A new camera is placed along the paper's
chain, map ← robot ← face ← camera, in each particle for itself; when the robot meets a known camera
again, particles in which it stands where they expect it gain weight.

A pose is drawn as late as can be: while one camera sees the robot, that camera and the robot are
one Gaussian in each particle, and when the next one sees it the pose is drawn from what odometry
and both cameras say together (FastSLAM 2.0, 2003, draws at every sighting).

A revisit is thousands of times more informative than the particles' spread, and would leave a
handful of them. Its likelihood is taken in shares that leave half of them effective, with
low-variance resampling after each (`particle_resampling`, decision 0641).
"""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.motion import odometry_step
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians

from .filter_state import Innovation, ReadSighting
from .particle_resampling import effective_sample_size, largest_share, normalised
from .particles import PARTICLES, CameraParticles, Particles, transposed
from .pose_samples import PoseSamples
from .relative_pose import RelativeView
from .sequential import SequentialEstimator

_MOST_SHARES = 200
_MOST_LINEARISATIONS = 3
# Weights as even as this carry no information: less than a hundredth of a sigma.
_ALIKE = 0.9999


def particle_filter(data: DataSet) -> SequentialEstimator:
    """The estimator «particle»."""
    return SequentialEstimator(data, ParticleFilterState.at_origin)


class _Terms(Struct, frozen=True):
    """A sighting in each of n particles: residual (n, k) of unit noise; its derivative (n, k, m) by
    the robot, its companion if it has one, and the camera; and the inverse of its covariance
    (n, k, k)."""

    residual: Array
    jacobian: Array
    information: Array

    @property
    def log_likelihood(self) -> Array:
        """The log likelihood of each particle, (n,), up to a constant."""
        solved = (self.information @ self.residual[..., None])[..., 0]
        _, log_determinant = np.linalg.slogdet(self.information)
        return -0.5 * (np.sum(self.residual * solved, axis=1) - log_determinant)


class _Relative(Struct, frozen=True):
    """camera_from_base (n) in each particle; its derivative (n, 6, m) by the robot, its companion
    if it has one, and the camera; their covariance (n, m, m) together, and its own (n, 6, 6)."""

    camera_from_base: Pose
    jacobian: Array
    covariance: Array
    spread: Array

    def expected(self, camera_from_base: Pose) -> tuple[Array, Array]:
        """Mean (6,) and covariance (6, 6), over all particles, of the disturbance from a pose."""
        apart = self.camera_from_base.difference(camera_from_base)
        return apart.mean(axis=0), np.cov(apart.T, bias=True) + self.spread.mean(axis=0)

    def terms(self, view: RelativeView) -> _Terms:
        """The terms of a sighting in each particle."""
        apart = self.camera_from_base.difference(view.camera_from_base)
        total = view.root @ self.spread @ view.root.T + np.eye(len(view.residual))
        residual = view.residual + apart @ view.root.T
        return _Terms(residual, view.root @ self.jacobian, np.linalg.inv(total))

    def innovation_chi2(self, view: RelativeView) -> float:
        """χ² of the innovation, for all particles together as one Gaussian."""
        mean, covariance = self.expected(view.camera_from_base)
        residual = view.residual + view.root @ mean
        total = view.root @ covariance @ view.root.T + np.eye(len(residual))
        return float(residual @ np.linalg.solve(total, residual))


class ParticleFilterState(Particles, frozen=True):
    """See `FilterState`."""

    @classmethod
    def at_origin(cls, data: DataSet) -> "ParticleFilterState":
        """Before any sighting: the first robot where its odometry begins, or the known cameras;
        before odometry nothing."""
        filter_state = cls(data.site.fusion.seed)
        if data.known.poses:
            return filter_state._with_known(data) if data.has_odometry else filter_state
        robot = data.anchored_robot
        assert robot is not None  # no camera is known
        track = data.tracks[robot]
        if not len(track):
            return filter_state
        filter_state = filter_state.with_robot(data, robot, track.odom_from_base[0], track.first_ns)
        here = filter_state.robots[robot]
        there = replace(here, spread=np.zeros(here.spread.shape))
        return replace(filter_state, robots={robot: there})

    def _with_known(self, data: DataSet) -> "ParticleFilterState":
        joint = data.known_at_start.covariance
        random = self.random()
        drawn = random.standard_normal((PARTICLES, len(joint))) @ np.linalg.cholesky(joint).T
        located, sure = {}, np.zeros((PARTICLES, 6, 6))
        for index, (name, pose) in enumerate(data.known.poses.items()):
            samples = pose.repeated(PARTICLES).disturbed(drawn[:, 6 * index : 6 * index + 6])
            located[name] = CameraParticles(PoseSamples.of(samples), sure, data.lenses[name])
        return replace(self, draws=self.draws + 1, located=located)

    # -- odometry ---------------------------------------------------------------------------------

    def advanced(self, data: DataSet, robot: str, stamp_ns: int) -> "ParticleFilterState":
        """Each particle moved on by odometry; its noise is drawn when the next sighting comes."""
        here, mean_scales = self.robots[robot], self.scales(robot)
        if stamp_ns <= here.stamp_ns:
            return self
        moments_ns = np.array([here.stamp_ns, stamp_ns])
        motion = data.tracks[robot].motion(moments_ns, mean_scales)
        step = odometry_step(here.poses.poses, motion)
        by_motion = step.by_motion[:, here.tangent]
        noise = by_motion @ motion.covariance[0] @ transposed(by_motion)
        by_start = step.by_start[:, here.tangent][..., here.tangent]
        end = step.end
        if robot in self.scale_errors:
            apart = self.scale_errors[robot] - mean_scales
            end = end.disturbed((step.by_scales @ apart[..., None])[..., 0])
        there = replace(
            here,
            stamp_ns=stamp_ns,
            poses=PoseSamples.of(end),
            spread=by_start @ here.spread @ transposed(by_start) + noise,
            crossed=by_start @ here.crossed,
        )
        return replace(self, robots=self.robots | {robot: there})

    # -- sightings --------------------------------------------------------------------------------

    def updated(
        self, data: DataSet, sighting: ReadSighting
    ) -> tuple["ParticleFilterState", Innovation] | None:
        robot, camera = sighting.observation.robot, sighting.observation.camera
        filter_state = self.with_drawn(
            n for n, here in self.robots.items() if here.companion == camera and n != robot
        )
        if sighting.places_robot:
            stamp_ns = sighting.observation.stamp_ns
            filter_state = filter_state.with_robot(data, robot, sighting.map_from_base, stamp_ns)
        relative = filter_state._relative(robot, camera)
        view = filter_state._linearised(data, sighting, relative)
        if view is None:
            return None
        chi2 = relative.innovation_chi2(view)
        free = len(filter_state.robots[robot].tangent) if sighting.places_robot else 0
        freedom = len(view.residual) - free
        filter_state = filter_state._conditioned(view, relative, robot, camera)
        eye, pose = filter_state.located[camera], filter_state.robots[robot].poses.mean
        after = sighting.view(data, eye.lens, eye.poses.mean.inverse() @ pose)
        rms_px = after.rms_px if after is not None else view.rms_px
        total = chi2 + view.left_over
        return filter_state, Innovation(chi2, freedom, total, freedom + view.freedom, rms_px)

    def with_camera(
        self, data: DataSet, sighting: ReadSighting, camera: CameraState
    ) -> tuple["ParticleFilterState", Innovation] | None:
        """Draw each particle's pose, and place the camera by it, with the sighting's covariance."""
        robot, name = sighting.observation.robot, sighting.observation.camera
        camera_from_base = camera.map_from_camera.inverse() @ sighting.map_from_base
        view = sighting.view(data, camera.lens, camera_from_base)
        if view is None or not view.determines_pose:
            return None
        filter_state = self.with_drawn([robot])
        here = filter_state.robots[robot]
        pose = here.poses.poses
        place = pose @ camera_from_base.inverse()
        by_camera, _ = relative_jacobians(place, pose)
        inverse = np.linalg.inv(view.root @ by_camera)
        poses = PoseSamples.of(place.disturbed(-inverse @ view.residual))
        placed = CameraParticles(poses, inverse @ transposed(inverse), camera.lens)
        there = replace(here, companion=name, crossed=np.zeros(here.crossed.shape))
        filter_state = replace(
            filter_state,
            robots=filter_state.robots | {robot: there},
            located=filter_state.located | {name: placed},
        )
        return filter_state, Innovation(0.0, 0, view.left_over, view.freedom, view.rms_px)

    def _relative(self, robot: str, camera: str) -> _Relative:
        """A camera's view of the robot in each particle."""
        here, place = self.robots[robot], self.located[camera].poses.poses
        pose = here.poses.poses
        by_camera, by_base = relative_jacobians(place, pose)
        group = self._group(robot, camera)
        parts = [by_base[..., here.tangent]]
        parts += [np.zeros((PARTICLES, 6, 6))] * (len(group) - 1)
        jacobian = np.concatenate([*parts, by_camera], axis=-1)
        covariance = self.together(robot, group)
        spread = jacobian @ covariance @ transposed(jacobian)
        return _Relative(place.inverse() @ pose, jacobian, covariance, spread)

    def _linearised(
        self, data: DataSet, sighting: ReadSighting, relative: _Relative
    ) -> RelativeView | None:
        """The sighting linearised about the best camera_from_base by it and the particles."""
        eye = self.located[sighting.observation.camera]
        view = sighting.view(data, eye.lens, eye.poses.mean.inverse() @ sighting.map_from_base)
        for _ in range(_MOST_LINEARISATIONS - 1):
            if view is None or len(view.root) < 6:
                return None
            mean, covariance = relative.expected(view.camera_from_base)
            # d = mean + e, |residual + root d|² + eᵀ covariance⁻¹ e is least at:
            gain = covariance @ view.root.T
            gain = gain @ np.linalg.inv(view.root @ gain + np.eye(len(view.root)))
            best = mean - gain @ (view.residual + view.root @ mean)
            view = sighting.view(data, eye.lens, view.camera_from_base.disturbed(best))
        return view

    def _group(self, robot: str, camera: str) -> list[str]:
        """The cameras that a sighting moves in a particle: the robot's companion and this one."""
        companion = self.robots[robot].companion
        return [camera] if companion in (None, camera) else [companion, camera]

    def _conditioned(
        self, view: RelativeView, relative: _Relative, robot: str, camera: str
    ) -> "ParticleFilterState":
        """The particles resampled by the likelihood of the sighting, in shares that keep half of
        them effective, and each updated by it."""
        filter_state, terms, left = self, relative.terms(view), 1.0
        for _ in range(_MOST_SHARES):
            log_likelihood = terms.log_likelihood
            share = largest_share(log_likelihood, left)
            weights = normalised(share * log_likelihood)
            if effective_sample_size(weights) < _ALIKE * PARTICLES:
                filter_state = filter_state.resampled(terms.residual, weights)
                relative = filter_state._relative(robot, camera)
                terms = relative.terms(view)
            left -= share
            if left <= 0:
                return filter_state._improved(relative, terms, robot, camera)
        raise ValueError("no particle is consistent with the sightings")

    def _improved(
        self, relative: _Relative, terms: _Terms, robot: str, camera: str
    ) -> "ParticleFilterState":
        """Each particle's Gaussians updated by the sighting; where another camera saw the robot
        before, the robot's pose is drawn, after which the two cameras are uncorrelated."""
        covariance, jacobian = relative.covariance, terms.jacobian
        gain = covariance @ transposed(jacobian) @ terms.information
        step = -(gain @ terms.residual[..., None])[..., 0]
        # Joseph's form, (I - G J) P (I - G J)ᵀ + G Gᵀ, by products of narrow matrices alone.
        kept = covariance - gain @ (jacobian @ covariance)
        better = kept + (gain - kept @ transposed(jacobian)) @ transposed(gain)
        group = self._group(robot, camera)
        if len(group) > 1:
            return self.drawn_from(robot, group, step, better)
        return self.moved(robot, group, [step], better)
