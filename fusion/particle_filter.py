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

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .belief import Sight, Surprise, carry
from .dataset import DataSet
from .estimator import CameraEstimate
from .filter import RobotEstimate
from .particle_resampling import (
    largest_share,
    low_variance_indices,
    moments,
    normalised,
    resampled,
)
from .problem import CameraState
from .relative_view import RelativeView, relative_jacobians, relative_view
from .sequential import SequentialEstimator

PARTICLES = 2000
_MOST_SHARES = 200
_MOST_LINEARISATIONS = 3
# A sighting determines a camera where the weakest direction is known at least this much, relative
# to the best known one.
_DETERMINED = 1e-7
_UNKNOWN_VARIANCE = 100.0**2  # m² and rad²: where a robot is that nothing ties to the map
_SHOWN = 500


def particle_filter(data: DataSet) -> SequentialEstimator:
    """The estimator «particle»."""
    return SequentialEstimator(data, ParticleBelief.at_origin)


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
class ParticleBelief:
    """See `Belief`; n particles with `log_weights` (n,).

    `poses`: robot -> map_from_base (n), with `spreads` (n, d, d) of what is not drawn yet;
    `companions`: robot -> the camera that saw it last, with `crossed` (n, d, 6) between the two;
    `places`: camera -> map_from_camera (n) with `covariances` (n, 6, 6), given what is drawn;
    `scale_errors`: robot -> (n, 2). `seed`, `draws`: what random numbers come next.
    """

    seed: int
    draws: int
    log_weights: Array
    stamps_ns: dict[str, int]
    tangents: dict[str, list[int]]
    poses: dict[str, Pose]
    spreads: dict[str, Array]
    companions: dict[str, str]
    crossed: dict[str, Array]
    places: dict[str, Pose]
    covariances: dict[str, Array]
    lenses: dict[str, CameraModel]
    scale_errors: dict[str, Array]

    @classmethod
    def at_origin(cls, data: DataSet) -> "ParticleBelief":
        """Before any sighting: the first robot where its odometry begins, or the known cameras."""
        even = np.zeros(PARTICLES)
        belief = cls(data.site.fusion.seed, 0, even, *({} for _ in range(10)))
        if data.known.poses:
            return belief._with_known(data)
        robot = data.anchored_robot
        assert robot is not None  # no camera is known
        track = data.tracks[robot]
        belief = belief._with_robot(data, robot, track.odom_from_base[0], track.first_ns)
        d = len(track.tangent)
        nothing = np.zeros((PARTICLES, d, d))
        return replace(belief, spreads=belief.spreads | {robot: nothing})

    def _with_known(self, data: DataSet) -> "ParticleBelief":
        joint = np.linalg.inv(data.known.information)
        random = self._random()
        drawn = random.standard_normal((PARTICLES, len(joint))) @ np.linalg.cholesky(joint).T
        places = {}
        for index, (name, pose) in enumerate(data.known.poses.items()):
            places[name] = _many(pose).disturbed(drawn[:, 6 * index : 6 * index + 6])
        return replace(
            self,
            draws=self.draws + 1,
            places=places,
            covariances={name: np.zeros((PARTICLES, 6, 6)) for name in places},
            lenses={name: data.lenses[name] for name in places},
        )

    def _with_robot(
        self, data: DataSet, robot: str, map_from_base: Pose, stamp_ns: int
    ) -> "ParticleBelief":
        """With a robot at about a place, of which nothing is known."""
        tangent = data.tracks[robot].tangent
        wide = np.broadcast_to(
            _UNKNOWN_VARIANCE * np.eye(len(tangent)), (PARTICLES, *[len(tangent)] * 2)
        )
        belief = replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            tangents=self.tangents | {robot: tangent},
            poses=self.poses | {robot: _many(map_from_base)},
            spreads=self.spreads | {robot: wide},
        )
        noise = data.site.robots[robot].odometry
        sigmas = np.array([noise.distance_scale, noise.heading_scale])
        if robot in self.scale_errors or not np.any(sigmas > 0):
            return belief
        drawn = self._random().standard_normal((PARTICLES, 2)) * sigmas
        scales = self.scale_errors | {robot: drawn}
        return replace(belief, draws=self.draws + 1, scale_errors=scales)

    def _random(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.draws])

    # -- what is believed -------------------------------------------------------------------------

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.places)

    @property
    def weights(self) -> Array:
        """(n,), summing to 1."""
        return normalised(self.log_weights)

    def camera(self, camera: str) -> CameraState:
        return CameraState(_mean(self.places[camera], self.weights), self.lenses[camera])

    def estimate(self, camera: str) -> CameraEstimate:
        lens = self.lenses[camera]
        return CameraEstimate(
            _mean(self.places[camera], self.weights),
            self.joint_covariance([camera]),
            lens,
            np.zeros(len(lens.parameters)),
            0.0,
            0.0,
        )

    def robot(self, robot: str) -> RobotEstimate:
        weights, tangent = self.weights, self.tangents[robot]
        mean = _mean(self.poses[robot], weights)
        apart = self.poses[robot].difference(mean)[:, tangent]
        _, covariance = moments(apart, weights)
        covariance = covariance + np.einsum("n,nij->ij", weights, self.spreads[robot])
        full = np.zeros((6, 6))
        full[np.ix_(tangent, tangent)] = covariance
        return RobotEstimate(self.stamps_ns[robot], mean, full)

    def scales(self, robot: str) -> Array:
        if robot not in self.scale_errors:
            return np.zeros(2)
        return self.weights @ self.scale_errors[robot]

    def joint_covariance(self, cameras: list[str]) -> Array:
        """Between the particles and, on the diagonal, within them."""
        weights = self.weights
        means = [_mean(self.places[name], weights) for name in cameras]
        errors = [self.places[n].difference(m) for n, m in zip(cameras, means, strict=True)]
        _, joint = moments(np.concatenate(errors, axis=1), weights)
        for index, name in enumerate(cameras):
            rows = slice(6 * index, 6 * index + 6)
            joint[rows, rows] += np.einsum("n,nij->ij", weights, self.covariances[name])
        return joint

    def particles(self, robot: str) -> Pose:
        random = np.random.default_rng([self.seed, self.draws, _SHOWN])
        chosen = low_variance_indices(self.weights, random)
        chosen = chosen[np.linspace(0, len(chosen) - 1, _SHOWN).astype(int)]
        tangent = self.tangents[robot]
        drawn = np.zeros((_SHOWN, 6))
        drawn[:, tangent] = _drawn(self.spreads[robot][chosen], random)
        return self.poses[robot][chosen].disturbed(drawn)

    # -- odometry ---------------------------------------------------------------------------------

    def advanced(self, data: DataSet, robot: str, stamp_ns: int) -> "ParticleBelief":
        """Each particle moved on by odometry; its noise is drawn when the next sighting comes."""
        if stamp_ns <= self.stamps_ns[robot]:
            return self
        mean_scales = self.scales(robot)
        moments_ns = np.array([self.stamps_ns[robot], stamp_ns])
        motion = data.tracks[robot].motion(moments_ns, mean_scales)
        step = carry(self.poses[robot], motion)
        tangent = self.tangents[robot]
        free = np.ix_(range(PARTICLES), tangent, tangent)
        noise = (step.by_motion @ motion.covariance[0] @ _transposed(step.by_motion))[free]
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
            | {robot: by_start @ self.spreads[robot] @ _transposed(by_start) + noise},
            crossed={n: by_start @ c if n == robot else c for n, c in self.crossed.items()},
        )

    # -- sightings --------------------------------------------------------------------------------

    def updated(self, data: DataSet, sight: Sight) -> tuple["ParticleBelief", Surprise] | None:
        robot, camera = sight.observation.robot, sight.observation.camera
        belief = self._with_drawn(
            n for n, c in self.companions.items() if c == camera and n != robot
        )
        if sight.is_tie:
            stamp_ns = sight.observation.stamp_ns
            belief = belief._with_robot(data, robot, sight.map_from_base, stamp_ns)
        view = belief._linearised(data, sight)
        if view is None:
            return None
        chi2 = belief._innovation(view, robot, camera)
        freedom = len(view.residual) - (len(belief.tangents[robot]) if sight.is_tie else 0)
        belief = belief._weighted(view, robot, camera)._improved(view, robot, camera)
        after = belief._view(data, sight, belief._relative(robot, camera))
        rms_px = after.rms_px if after is not None else view.rms_px
        total = chi2 + view.left_over
        return belief, Surprise(chi2, freedom, total, freedom + view.freedom, rms_px)

    def with_camera(
        self, data: DataSet, sight: Sight, camera: CameraState
    ) -> tuple["ParticleBelief", Surprise] | None:
        """Each particle's pose is drawn, and the camera placed by it, with the sighting's error."""
        robot, name = sight.observation.robot, sight.observation.camera
        camera_from_base = camera.map_from_camera.inverse() @ sight.map_from_base
        target = data.targets[robot]
        view = relative_view(sight.observation, target, camera.lens, camera_from_base)
        if view is None or len(view.root) < 6:
            return None
        strength = np.linalg.svd(view.root, compute_uv=False)
        if strength[-1] < _DETERMINED * strength[0]:
            return None
        belief = self._with_drawn([robot])
        pose = belief.poses[robot]
        place = pose @ camera_from_base.inverse()
        by_camera, _ = relative_jacobians(place, pose)
        inverse = np.linalg.inv(view.root @ by_camera)
        belief = replace(
            belief,
            places=belief.places | {name: place.disturbed(-inverse @ view.residual)},
            covariances=belief.covariances | {name: inverse @ _transposed(inverse)},
            lenses=belief.lenses | {name: camera.lens},
            companions=belief.companions | {robot: name},
            crossed=belief.crossed | {robot: np.zeros((PARTICLES, len(belief.tangents[robot]), 6))},
        )
        return belief, Surprise(0.0, 0, view.left_over, view.freedom, view.rms_px)

    def _with_drawn(self, robots: Iterable[str]) -> "ParticleBelief":
        """With the poses of some robots drawn from what is left open of them."""
        belief = self
        for robot in robots:
            companion = belief.companions.get(robot)
            names = [companion] if companion is not None else []
            belief = belief._drawn_from(robot, names, belief._together(robot, names))
        return belief

    def _together(self, robot: str, cameras: list[str]) -> Array:
        """Covariance (n, m, m) of a robot's pose and some cameras in each particle."""
        d = len(self.tangents[robot])
        whole = np.zeros((PARTICLES, d + 6 * len(cameras), d + 6 * len(cameras)))
        whole[:, :d, :d] = self.spreads[robot]
        for index, name in enumerate(cameras):
            rows = slice(d + 6 * index, d + 6 * index + 6)
            whole[:, rows, rows] = self.covariances[name]
            if self.companions.get(robot) == name:
                whole[:, :d, rows] = self.crossed[robot]
                whole[:, rows, :d] = _transposed(self.crossed[robot])
        return whole

    def _drawn_from(self, robot: str, cameras: list[str], covariance: Array) -> "ParticleBelief":
        """The robot's pose drawn, and the cameras moved with it, by their covariance together."""
        d = len(self.tangents[robot])
        own, others = covariance[:, :d, :d], covariance[:, d:, :d]
        gain = others @ np.linalg.pinv(own, rcond=1e-12, hermitian=True)
        drawn = _drawn(own, self._random())
        follows = (gain @ drawn[..., None])[..., 0]
        left = covariance[:, d:, d:] - gain @ _transposed(others)
        whole = np.zeros_like(covariance)
        whole[:, d:, d:] = left
        step = np.concatenate([drawn, follows], axis=1)
        belief = replace(self, draws=self.draws + 1)
        return belief._moved(robot, cameras, step, whole)

    def _moved(
        self, robot: str, cameras: list[str], step: Array, covariance: Array
    ) -> "ParticleBelief":
        """A robot and cameras moved by steps (n, m) of theirs, with their covariance (n, m, m)
        then; the last camera goes with the robot from now on."""
        tangent = self.tangents[robot]
        d = len(tangent)
        disturbance = np.zeros((PARTICLES, 6))
        disturbance[:, tangent] = step[:, :d]
        places, covariances = dict(self.places), dict(self.covariances)
        companions, crossed = dict(self.companions), dict(self.crossed)
        companions.pop(robot, None)
        crossed.pop(robot, None)
        for index, name in enumerate(cameras):
            rows = slice(d + 6 * index, d + 6 * index + 6)
            places[name] = places[name].disturbed(step[:, rows])
            covariances[name] = symmetric(covariance[:, rows, rows])
            companions[robot], crossed[robot] = name, covariance[:, :d, rows]
        return replace(
            self,
            poses=self.poses | {robot: self.poses[robot].disturbed(disturbance)},
            spreads=self.spreads | {robot: symmetric(covariance[:, :d, :d])},
            companions=companions,
            crossed=crossed,
            places=places,
            covariances=covariances,
        )

    def _relative(self, robot: str, camera: str) -> Pose:
        """camera_from_base by the mean camera and robot."""
        weights = self.weights
        map_from_camera = _mean(self.places[camera], weights)
        return map_from_camera.inverse() @ _mean(self.poses[robot], weights)

    def _view(self, data: DataSet, sight: Sight, camera_from_base: Pose) -> RelativeView | None:
        observation = sight.observation
        lens = self.lenses[observation.camera]
        return relative_view(observation, data.targets[observation.robot], lens, camera_from_base)

    def _linearised(self, data: DataSet, sight: Sight) -> RelativeView | None:
        """The sighting about the camera_from_base that it and the particles say together."""
        robot, camera = sight.observation.robot, sight.observation.camera
        place = _mean(self.places[camera], self.weights)
        view = self._view(data, sight, place.inverse() @ sight.map_from_base)
        for _ in range(_MOST_LINEARISATIONS - 1):
            if view is None or len(view.root) < 6:
                return None
            mean, covariance = self._expected(view, robot, camera)
            # d = mean + e, |residual + root d|² + eᵀ covariance⁻¹ e is least at:
            gain = covariance @ view.root.T
            gain = gain @ np.linalg.inv(view.root @ gain + np.eye(len(view.root)))
            best = mean - gain @ (view.residual + view.root @ mean)
            view = self._view(data, sight, view.camera_from_base.disturbed(best))
        return view

    def _expected(self, view: RelativeView, robot: str, camera: str) -> tuple[Array, Array]:
        """Mean (6,) and covariance (6, 6) of the disturbance of the view's camera_from_base."""
        weights, place, pose = self.weights, self.places[camera], self.poses[robot]
        apart = (place.inverse() @ pose).difference(view.camera_from_base)
        mean, covariance = moments(apart, weights)
        jacobian = self._jacobian(np.eye(6), robot, camera)
        within = jacobian @ self._together(robot, self._group(robot, camera))
        within = within @ _transposed(jacobian)
        return mean, covariance + np.einsum("n,nij->ij", weights, within)

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

    def _innovation(self, view: RelativeView, robot: str, camera: str) -> float:
        """χ² of the innovation, for all particles together as one Gaussian."""
        mean, covariance = self._expected(view, robot, camera)
        residual = view.residual + view.root @ mean
        total = view.root @ covariance @ view.root.T + np.eye(len(residual))
        return float(residual @ np.linalg.solve(total, residual))

    def _terms(self, view: RelativeView, robot: str, camera: str) -> _Terms:
        relative = self.places[camera].inverse() @ self.poses[robot]
        apart = relative.difference(view.camera_from_base)
        jacobian = self._jacobian(view.root, robot, camera)
        covariance = self._together(robot, self._group(robot, camera))
        total = jacobian @ covariance @ _transposed(jacobian) + np.eye(len(view.residual))
        return _Terms(view.residual + apart @ view.root.T, jacobian, covariance, total)

    def _weighted(self, view: RelativeView, robot: str, camera: str) -> "ParticleBelief":
        """Particles by how well they expect the sighting, in shares that keep half effective."""
        belief, left = self, 1.0
        for _ in range(_MOST_SHARES):
            log_likelihood = belief._terms(view, robot, camera).log_likelihood
            share = largest_share(belief.log_weights, log_likelihood, left)
            belief = replace(belief, log_weights=belief.log_weights + share * log_likelihood)
            left -= share
            if left <= 0:
                return belief
            belief = belief._resampled()
        raise ValueError("no particle is near what is seen")

    def _resampled(self) -> "ParticleBelief":
        """Equally weighted particles, drawn apart over everything that they hold together."""
        weights = self.weights
        robots = {name: _mean(pose, weights) for name, pose in self.poses.items()}
        cameras = {name: _mean(place, weights) for name, place in self.places.items()}
        parts = [self.poses[n].difference(m)[:, self.tangents[n]] for n, m in robots.items()]
        parts += [self.places[n].difference(m) for n, m in cameras.items()]
        parts += list(self.scale_errors.values())
        errors = np.concatenate(parts, axis=1)
        indices, drawn = resampled(errors, weights, self._random())
        split = iter(np.split(drawn, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1))
        poses = {}
        for name, mean in robots.items():
            disturbance = np.zeros((PARTICLES, 6))
            disturbance[:, self.tangents[name]] = next(split)
            poses[name] = _many(mean).disturbed(disturbance)
        return replace(
            self,
            draws=self.draws + 1,
            log_weights=np.zeros(PARTICLES),
            poses=poses,
            spreads={name: spread[indices] for name, spread in self.spreads.items()},
            places={name: _many(mean).disturbed(next(split)) for name, mean in cameras.items()},
            covariances={name: c[indices] for name, c in self.covariances.items()},
            crossed={name: c[indices] for name, c in self.crossed.items()},
            scale_errors={name: next(split) for name in self.scale_errors},
        )

    def _improved(self, view: RelativeView, robot: str, camera: str) -> "ParticleBelief":
        """Each particle's Gaussians by the sighting; where another camera saw the robot before,
        its pose is drawn, after which the two know nothing of each other."""
        terms, group = self._terms(view, robot, camera), self._group(robot, camera)
        gain = terms.covariance @ _transposed(terms.jacobian) @ np.linalg.inv(terms.total)
        step = -(gain @ terms.residual[..., None])[..., 0]
        keep = np.eye(gain.shape[1]) - gain @ terms.jacobian
        better = keep @ terms.covariance @ _transposed(keep) + gain @ _transposed(gain)
        belief = self._moved(robot, group, step, better)
        return belief._drawn_from(robot, group, better) if len(group) > 1 else belief

    # -- what goes ---------------------------------------------------------------------------------

    def without_camera(self, camera: str) -> "ParticleBelief":
        return replace(
            self,
            places={name: place for name, place in self.places.items() if name != camera},
            covariances={name: c for name, c in self.covariances.items() if name != camera},
            companions={name: c for name, c in self.companions.items() if c != camera},
            crossed={n: c for n, c in self.crossed.items() if self.companions[n] != camera},
        )

    def without_robot(self, robot: str) -> "ParticleBelief":
        return replace(
            self,
            companions={name: c for name, c in self.companions.items() if name != robot},
            crossed={name: c for name, c in self.crossed.items() if name != robot},
            stamps_ns={name: stamp for name, stamp in self.stamps_ns.items() if name != robot},
            poses={name: pose for name, pose in self.poses.items() if name != robot},
            spreads={name: spread for name, spread in self.spreads.items() if name != robot},
        )


def _many(pose: Pose) -> Pose:
    """The same pose in every particle."""
    return Pose(
        np.broadcast_to(pose.rotation, (PARTICLES, 3, 3)),
        np.broadcast_to(pose.translation, (PARTICLES, 3)),
    )


def _mean(poses: Pose, weights: Array) -> Pose:
    """The pose from which the weighted disturbances to all of them add up to nothing."""
    mean = poses[0]
    for _ in range(2):
        mean = mean.disturbed(weights @ poses.difference(mean))
    return mean


def _drawn(covariances: Array, random: np.random.Generator) -> Array:
    """A normal draw (n, d) from each covariance (n, d, d), which may be nothing."""
    values, vectors = np.linalg.eigh(covariances)
    draws = random.standard_normal(values.shape) * np.sqrt(np.maximum(values, 0.0))
    return (vectors @ draws[..., None])[..., 0]


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)
