"""Particles: robots' poses, drawn, and the cameras' Gaussian estimates given those."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .particle_resampling import independent_draws, resampled

PARTICLES = 2000
_UNKNOWN_VARIANCE = 100.0**2  # m² and rad²: where a robot is that nothing ties to the map
_SHOWN = 500


@dataclass(frozen=True, slots=True)
class Particles:
    """n particles, all equally likely; immutable.

    `poses`: robot -> map_from_base (n), with `spreads` (n, d, d) of what is not drawn yet;
    `companions`: robot -> the camera that saw it last, with `crossed` (n, d, 6) between the two;
    `places`: camera -> map_from_camera (n) with `covariances` (n, 6, 6), given what is drawn;
    `scale_errors`: robot -> (n, 2). `seed`, `draws`: what random numbers come next.
    """

    seed: int
    draws: int
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

    def random(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.draws])

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.places)

    def camera(self, camera: str) -> CameraState:
        return CameraState(mean_pose(self.places[camera]), self.lenses[camera])

    def estimate(self, camera: str) -> CameraEstimate:
        lens = self.lenses[camera]
        return CameraEstimate(
            mean_pose(self.places[camera]),
            self.joint_covariance([camera]),
            lens,
            np.zeros(len(lens.parameters)),
            0.0,
            0.0,
        )

    def robot(self, robot: str) -> RobotEstimate:
        tangent = self.tangents[robot]
        mean = mean_pose(self.poses[robot])
        apart = self.poses[robot].difference(mean)[:, tangent]
        covariance = np.cov(apart.T, bias=True) + self.spreads[robot].mean(axis=0)
        full = np.zeros((6, 6))
        full[np.ix_(tangent, tangent)] = covariance
        return RobotEstimate(self.stamps_ns[robot], mean, full)

    def scales(self, robot: str) -> Array:
        if robot not in self.scale_errors:
            return np.zeros(2)
        return self.scale_errors[robot].mean(axis=0)

    def joint_covariance(self, cameras: list[str]) -> Array:
        """Between the particles and, on the diagonal, within them."""
        means = [mean_pose(self.places[name]) for name in cameras]
        errors = [self.places[n].difference(m) for n, m in zip(cameras, means, strict=True)]
        joint = np.cov(np.concatenate(errors, axis=1).T, bias=True)
        for index, name in enumerate(cameras):
            rows = slice(6 * index, 6 * index + 6)
            joint[rows, rows] += self.covariances[name].mean(axis=0)
        return joint

    def particles(self, robot: str) -> Pose:
        random = np.random.default_rng([self.seed, self.draws, _SHOWN])
        chosen = random.choice(PARTICLES, _SHOWN, replace=False)
        tangent = self.tangents[robot]
        drawn = np.zeros((_SHOWN, 6))
        draws = random.standard_normal((_SHOWN, len(tangent)))
        drawn[:, tangent] = stretched(draws, self.spreads[robot][chosen])
        return self.poses[robot][chosen].disturbed(drawn)

    # -- changes -----------------------------------------------------------------------------------

    def with_robot(self, data: DataSet, robot: str, map_from_base: Pose, stamp_ns: int) -> Self:
        """With a robot at about a place, of which nothing is known."""
        tangent = data.tracks[robot].tangent
        wide = np.broadcast_to(
            _UNKNOWN_VARIANCE * np.eye(len(tangent)), (PARTICLES, *[len(tangent)] * 2)
        )
        filter_state = replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            tangents=self.tangents | {robot: tangent},
            poses=self.poses | {robot: map_from_base.repeated(PARTICLES)},
            spreads=self.spreads | {robot: wide},
        )
        noise = data.site.robots[robot].odometry
        sigmas = np.array([noise.distance_scale, noise.heading_scale])
        if robot in self.scale_errors or not np.any(sigmas > 0):
            return filter_state
        drawn = self.random().standard_normal((PARTICLES, 2)) * sigmas
        scales = self.scale_errors | {robot: drawn}
        return replace(filter_state, draws=self.draws + 1, scale_errors=scales)

    def with_drawn(self, robots: Iterable[str]) -> Self:
        """With the poses of some robots drawn from what is left open of them."""
        filter_state = self
        for robot in robots:
            companion = filter_state.companions.get(robot)
            names = [companion] if companion is not None else []
            filter_state = filter_state.drawn_from(
                robot, names, filter_state.together(robot, names)
            )
        return filter_state

    def together(self, robot: str, cameras: list[str]) -> Array:
        """Covariance (n, m, m) of a robot's pose and some cameras in each particle."""
        d = len(self.tangents[robot])
        whole = np.zeros((PARTICLES, d + 6 * len(cameras), d + 6 * len(cameras)))
        whole[:, :d, :d] = self.spreads[robot]
        for index, name in enumerate(cameras):
            rows = slice(d + 6 * index, d + 6 * index + 6)
            whole[:, rows, rows] = self.covariances[name]
            if self.companions.get(robot) == name:
                whole[:, :d, rows] = self.crossed[robot]
                whole[:, rows, :d] = transposed(self.crossed[robot])
        return whole

    def drawn_from(self, robot: str, cameras: list[str], covariance: Array) -> Self:
        """The robot's pose drawn, and the cameras moved with it, by their covariance together."""
        d = len(self.tangents[robot])
        own, others = covariance[:, :d, :d], covariance[:, d:, :d]
        gain = others @ np.linalg.pinv(own, rcond=1e-12, hermitian=True)
        drawn = self._drawn(own)
        follows = (gain @ drawn[..., None])[..., 0]
        left = covariance[:, d:, d:] - gain @ transposed(others)
        whole = np.zeros_like(covariance)
        whole[:, d:, d:] = left
        step = np.concatenate([drawn, follows], axis=1)
        filter_state = replace(self, draws=self.draws + 1)
        return filter_state.moved(robot, cameras, step, whole)

    def _drawn(self, covariances: Array) -> Array:
        """A normal draw (n, d) from each covariance (n, d, d), independent of all that is drawn."""
        errors = np.concatenate(self.errors()[2], axis=1)
        draws = independent_draws(errors, covariances.shape[-1], self.random())
        return stretched(draws, covariances)

    def moved(self, robot: str, cameras: list[str], step: Array, covariance: Array) -> Self:
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

    def errors(self) -> tuple[dict[str, Pose], dict[str, Pose], list[Array]]:
        """Mean robots and cameras, and each particle's disturbances of them, by part (n, …)."""
        robots = {name: mean_pose(pose) for name, pose in self.poses.items()}
        cameras = {name: mean_pose(place) for name, place in self.places.items()}
        parts = [self.poses[n].difference(m)[:, self.tangents[n]] for n, m in robots.items()]
        parts += [self.places[n].difference(m) for n, m in cameras.items()]
        return robots, cameras, [*parts, *self.scale_errors.values()]

    def resampled(self, shown: Array, weights: Array) -> Self:
        """Equally likely particles in place of weighted ones."""
        robots, cameras, parts = self.errors()
        errors = np.concatenate(parts, axis=1)
        drawn, indices = resampled(errors, shown, weights, self.random())
        split = iter(np.split(drawn, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1))
        poses = {}
        for name, mean in robots.items():
            disturbance = np.zeros((PARTICLES, 6))
            disturbance[:, self.tangents[name]] = next(split)
            poses[name] = mean.repeated(PARTICLES).disturbed(disturbance)
        return replace(
            self,
            draws=self.draws + 1,
            poses=poses,
            spreads={name: spread[indices] for name, spread in self.spreads.items()},
            places={
                name: mean.repeated(PARTICLES).disturbed(next(split))
                for name, mean in cameras.items()
            },
            covariances={name: c[indices] for name, c in self.covariances.items()},
            crossed={name: c[indices] for name, c in self.crossed.items()},
            scale_errors={name: next(split) for name in self.scale_errors},
        )

    def without_robot(self, robot: str) -> Self:
        return replace(
            self,
            companions={name: c for name, c in self.companions.items() if name != robot},
            crossed={name: c for name, c in self.crossed.items() if name != robot},
            stamps_ns={name: stamp for name, stamp in self.stamps_ns.items() if name != robot},
            poses={name: pose for name, pose in self.poses.items() if name != robot},
            spreads={name: spread for name, spread in self.spreads.items() if name != robot},
        )


def mean_pose(poses: Pose) -> Pose:
    """The pose from which the disturbances to all of them add up to nothing."""
    mean = poses[0]
    for _ in range(2):
        mean = mean.disturbed(poses.difference(mean).mean(axis=0))
    return mean


def stretched(draws: Array, covariances: Array) -> Array:
    """Standard normal draws (n, d) to covariances (n, d, d), which may be nothing."""
    values, vectors = np.linalg.eigh(covariances)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ transposed(vectors)
    return (root @ draws[..., None])[..., 0]


def transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)
