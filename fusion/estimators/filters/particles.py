"""Particles: robots' poses, drawn, and the cameras' Gaussian estimates given those."""

from collections.abc import Iterable
from typing import Self

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.estimators.interface import CameraEstimate
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import RobotEstimate
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .particle_resampling import independent_draws, resampled
from .pose_samples import PoseSamples

PARTICLES = 2000
_UNKNOWN_VARIANCE = 100.0**2  # m² and rad²: of a robot that nothing ties to the map
_SHOWN = 500
# Relative to the largest variance of a covariance: less is rounding.
_NOTHING = 1e-12


class Particles(Struct, frozen=True):
    """n particles, all equally likely; immutable.

    `poses`: robot -> map_from_base (n), with `spreads` (n, d, d) of what is not drawn yet;
    `companions`: robot -> the camera that saw it last, with `crossed` (n, d, 6) between the two;
    `places`: camera -> map_from_camera (n) with `covariances` (n, 6, 6), given what is drawn;
    `scale_errors`: robot -> (n, 2). `seed`, `draws`: determine the next random numbers.
    """

    seed: int
    draws: int
    stamps_ns: dict[str, int]
    tangents: dict[str, list[int]]
    poses: dict[str, PoseSamples]
    spreads: dict[str, Array]
    companions: dict[str, str]
    crossed: dict[str, Array]
    places: dict[str, PoseSamples]
    covariances: dict[str, Array]
    lenses: dict[str, CameraModel]
    scale_errors: dict[str, Array]

    def random(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.draws])

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.places)

    def camera(self, camera: str) -> CameraState:
        return CameraState(self.places[camera].mean, self.lenses[camera])

    def estimate(self, camera: str) -> CameraEstimate:
        lens = self.lenses[camera]
        return CameraEstimate(
            self.places[camera].mean,
            self.joint_covariance([camera]),
            lens,
            np.zeros(len(lens.parameters)),
            0.0,
            0.0,
        )

    def robot(self, robot: str) -> RobotEstimate:
        tangent = self.tangents[robot]
        apart = self.poses[robot].errors[:, tangent]
        covariance = np.cov(apart.T, bias=True) + self.spreads[robot].mean(axis=0)
        full = np.zeros((6, 6))
        full[np.ix_(tangent, tangent)] = covariance
        return RobotEstimate(self.stamps_ns[robot], self.poses[robot].mean, full)

    def scales(self, robot: str) -> Array:
        if robot not in self.scale_errors:
            return np.zeros(2)
        return self.scale_errors[robot].mean(axis=0)

    def joint_covariance(self, cameras: list[str]) -> Array:
        """The covariance between the particles plus, on the diagonal, the mean one within them."""
        errors = [self.places[name].errors for name in cameras]
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
        root, _ = roots(self.spreads[robot][chosen])
        drawn[:, tangent] = (root @ draws[..., None])[..., 0]
        return self.poses[robot].poses[chosen].disturbed(drawn)

    # -- changes -----------------------------------------------------------------------------------

    def with_robot(self, data: DataSet, robot: str, map_from_base: Pose, stamp_ns: int) -> Self:
        """With a robot about a pose, with a covariance as wide as if nothing were known."""
        tangent = data.tracks[robot].tangent
        wide = np.broadcast_to(
            _UNKNOWN_VARIANCE * np.eye(len(tangent)), (PARTICLES, *[len(tangent)] * 2)
        )
        filter_state = replace(
            self,
            stamps_ns=self.stamps_ns | {robot: stamp_ns},
            tangents=self.tangents | {robot: tangent},
            poses=self.poses | {robot: PoseSamples.of(map_from_base.repeated(PARTICLES))},
            spreads=self.spreads | {robot: wide},
        )
        noise = data.site.robots[robot].odometry
        sigmas = np.array([noise.distance_scale, noise.heading_scale])
        if robot in self.scale_errors or not np.any(sigmas > 0):
            return filter_state
        drawn = self.random().standard_normal((PARTICLES, 2)) * sigmas
        scales = self.scale_errors | {robot: drawn}
        return replace(filter_state, draws=self.draws + 1, scale_errors=scales)

    def spread(self, covariances: dict[str, Array]) -> Self:
        more = {name: self.covariances[name] + each for name, each in covariances.items()}
        return replace(self, covariances=self.covariances | more)

    def with_drawn(self, robots: Iterable[str]) -> Self:
        """With the poses of some robots drawn from their remaining covariance."""
        filter_state = self
        for robot in robots:
            companion = filter_state.companions.get(robot)
            names = [companion] if companion is not None else []
            covariance = filter_state.together(robot, names)
            none = np.zeros(covariance.shape[:2])
            filter_state = filter_state.drawn_from(robot, names, none, covariance)
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

    def drawn_from(self, robot: str, cameras: list[str], step: Array, covariance: Array) -> Self:
        """Draw the robot's pose and condition the cameras on it, given the mean steps (n, m) and
        the joint covariance (n, m, m) of them all."""
        d = len(self.tangents[robot])
        others = covariance[:, d:, :d]
        root, inverse = roots(covariance[:, :d, :d])
        gain = others @ inverse
        errors = np.concatenate([*self.errors(), step], axis=1)
        draws = independent_draws(errors, d, self.random())
        drawn = root @ draws[..., None]
        apart = np.concatenate([drawn, gain @ drawn], axis=1)[..., 0]
        whole = np.zeros_like(covariance)
        whole[:, d:, d:] = covariance[:, d:, d:] - gain @ transposed(others)
        filter_state = replace(self, draws=self.draws + 1)
        return filter_state.moved(robot, cameras, [step, apart], whole)

    def moved(self, robot: str, cameras: list[str], steps: list[Array], covariance: Array) -> Self:
        """Move a robot and cameras by steps (n, m), one after the other, and set their covariance
        (n, m, m) then; the last camera becomes the robot's companion."""
        tangent = self.tangents[robot]
        d = len(tangent)
        disturbances = [np.zeros((PARTICLES, 6)) for _ in steps]
        for disturbance, step in zip(disturbances, steps, strict=True):
            disturbance[:, tangent] = step[:, :d]
        places, covariances = dict(self.places), dict(self.covariances)
        companions, crossed = dict(self.companions), dict(self.crossed)
        companions.pop(robot, None)
        crossed.pop(robot, None)
        for index, name in enumerate(cameras):
            rows = slice(d + 6 * index, d + 6 * index + 6)
            places[name] = places[name].disturbed([step[:, rows] for step in steps])
            covariances[name] = symmetric(covariance[:, rows, rows])
            companions[robot], crossed[robot] = name, covariance[:, :d, rows]
        return replace(
            self,
            poses=self.poses | {robot: self.poses[robot].disturbed(disturbances)},
            spreads=self.spreads | {robot: symmetric(covariance[:, :d, :d])},
            companions=companions,
            crossed=crossed,
            places=places,
            covariances=covariances,
        )

    def errors(self) -> list[Array]:
        """Each particle's disturbances of the robots and the cameras, and its scale errors, by part
        (n, …)."""
        parts = [poses.disturbances[:, self.tangents[name]] for name, poses in self.poses.items()]
        parts += [places.disturbances for places in self.places.values()]
        return [*parts, *self.scale_errors.values()]

    def resampled(self, shown: Array, weights: Array) -> Self:
        """Equally likely particles in place of weighted ones."""
        parts = self.errors()
        errors = np.concatenate(parts, axis=1)
        drawn, indices = resampled(errors, shown, weights, self.random())
        split = iter(np.split(drawn, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1))
        poses = {}
        for name, samples in self.poses.items():
            disturbance = np.zeros((PARTICLES, 6))
            disturbance[:, self.tangents[name]] = next(split)
            poses[name] = samples.redrawn(disturbance)
        return replace(
            self,
            draws=self.draws + 1,
            poses=poses,
            spreads={name: spread[indices] for name, spread in self.spreads.items()},
            places={name: samples.redrawn(next(split)) for name, samples in self.places.items()},
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


def roots(covariances: Array) -> tuple[Array, Array]:
    """Symmetric square roots (n, d, d) of covariances (n, d, d), and the pseudo-inverses of the
    covariances, without the directions in which they vanish."""
    values, vectors = np.linalg.eigh(covariances)
    values = np.maximum(values, 0.0)
    some = values > _NOTHING * values[:, -1:]
    inverse = np.where(some, 1 / np.where(some, values, 1.0), 0.0)
    back = transposed(vectors)
    return vectors * np.sqrt(values)[:, None] @ back, vectors * inverse[:, None] @ back


def transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)
