"""Particles: robots' poses, drawn, and the cameras' Gaussian estimates given those."""

from collections.abc import Iterable
from typing import Self

import numpy as np
from msgspec import Struct, field
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


class RobotParticles(Struct, frozen=True):
    """A robot in each of n particles at its last node: `poses` (n), with the covariance `spread`
    (n, d, d) over the `tangent` of what is not drawn yet. `companion`: the camera that saw it last,
    with `crossed` (n, d, 6) between the two."""

    stamp_ns: int
    tangent: list[int]
    poses: PoseSamples
    spread: Array
    companion: str | None
    crossed: Array


class CameraParticles(Struct, frozen=True):
    """A camera in each of n particles: `poses` (n), its `covariance` (n, 6, 6) given what is
    drawn."""

    poses: PoseSamples
    covariance: Array
    lens: CameraModel


class Particles(Struct, frozen=True):
    """n particles, all equally likely; immutable. `scale_errors`: robot -> (n, 2); `seed`, `draws`:
    determine the next random numbers."""

    seed: int
    draws: int = 0
    robots: dict[str, RobotParticles] = field(default_factory=dict)
    located: dict[str, CameraParticles] = field(default_factory=dict)
    scale_errors: dict[str, Array] = field(default_factory=dict)

    def random(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, self.draws])

    @property
    def stamps_ns(self) -> dict[str, int]:
        return {name: here.stamp_ns for name, here in self.robots.items()}

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.located)

    def camera(self, camera: str) -> CameraState:
        return CameraState(self.located[camera].poses.mean, self.located[camera].lens)

    def estimate(self, camera: str) -> CameraEstimate:
        pose, lens = self.located[camera].poses.mean, self.located[camera].lens
        nothing = np.zeros(len(lens.parameters))
        return CameraEstimate(pose, self.joint_covariance([camera]), lens, nothing, 0.0, 0.0)

    def robot(self, robot: str) -> RobotEstimate:
        here, full = self.robots[robot], np.zeros((6, 6))
        centred = here.poses.centred
        apart = centred.disturbances[:, here.tangent]
        covariance = np.cov(apart.T, bias=True) + here.spread.mean(axis=0)
        full[np.ix_(here.tangent, here.tangent)] = covariance
        return RobotEstimate(here.stamp_ns, centred.about, full)

    def scales(self, robot: str) -> Array:
        if robot not in self.scale_errors:
            return np.zeros(2)
        return self.scale_errors[robot].mean(axis=0)

    def joint_covariance(self, cameras: list[str]) -> Array:
        """The covariance between the particles plus, on the diagonal, the mean one within them."""
        errors = [self.located[name].poses.centred.disturbances for name in cameras]
        joint = np.cov(np.concatenate(errors, axis=1).T, bias=True)
        for index, name in enumerate(cameras):
            rows = slice(6 * index, 6 * index + 6)
            joint[rows, rows] += self.located[name].covariance.mean(axis=0)
        return joint

    def particles(self, robot: str) -> Pose:
        random = np.random.default_rng([self.seed, self.draws, _SHOWN])
        chosen = random.choice(PARTICLES, _SHOWN, replace=False)
        here, drawn = self.robots[robot], np.zeros((_SHOWN, 6))
        draws = random.standard_normal((_SHOWN, len(here.tangent)))
        root, _ = roots(here.spread[chosen])
        drawn[:, here.tangent] = (root @ draws[..., None])[..., 0]
        return here.poses.poses[chosen].disturbed(drawn)

    # -- changes -----------------------------------------------------------------------------------

    def with_robot(self, data: DataSet, robot: str, map_from_base: Pose, stamp_ns: int) -> Self:
        """With a robot about a pose, with a covariance as wide as if nothing were known."""
        tangent, poses = data.tracks[robot].tangent, map_from_base.repeated(PARTICLES)
        d = len(tangent)
        wide = np.broadcast_to(_UNKNOWN_VARIANCE * np.eye(d), (PARTICLES, d, d))
        crossed = np.zeros((PARTICLES, d, 6))
        here = RobotParticles(stamp_ns, tangent, PoseSamples.of(poses), wide, None, crossed)
        filter_state = replace(self, robots=self.robots | {robot: here})
        noise = data.site.robots[robot].odometry
        sigmas = np.array([noise.distance_scale, noise.heading_scale])
        if robot in self.scale_errors or not np.any(sigmas > 0):
            return filter_state
        drawn = self.random().standard_normal((PARTICLES, 2)) * sigmas
        scales = self.scale_errors | {robot: drawn}
        return replace(filter_state, draws=self.draws + 1, scale_errors=scales)

    def spread(self, covariances: dict[str, Array]) -> Self:
        more = {
            name: replace(self.located[name], covariance=self.located[name].covariance + each)
            for name, each in covariances.items()
        }
        return replace(self, located=self.located | more)

    def with_drawn(self, robots: Iterable[str]) -> Self:
        """With the poses of some robots drawn from their remaining covariance."""
        filter_state = self
        for robot in robots:
            companion = filter_state.robots[robot].companion
            names = [companion] if companion is not None else []
            covariance = filter_state.together(robot, names)
            none = np.zeros(covariance.shape[:2])
            filter_state = filter_state.drawn_from(robot, names, none, covariance)
        return filter_state

    def together(self, robot: str, cameras: list[str]) -> Array:
        """Covariance (n, m, m) of a robot's pose and some cameras in each particle."""
        here = self.robots[robot]
        d = len(here.tangent)
        whole = np.zeros((PARTICLES, d + 6 * len(cameras), d + 6 * len(cameras)))
        whole[:, :d, :d] = here.spread
        for index, name in enumerate(cameras):
            rows = slice(d + 6 * index, d + 6 * index + 6)
            whole[:, rows, rows] = self.located[name].covariance
            if here.companion == name:
                whole[:, :d, rows] = here.crossed
                whole[:, rows, :d] = transposed(here.crossed)
        return whole

    def drawn_from(self, robot: str, cameras: list[str], step: Array, covariance: Array) -> Self:
        """Draw the robot's pose and condition the cameras on it, given the mean steps (n, m) and
        the joint covariance (n, m, m) of them all."""
        d = len(self.robots[robot].tangent)
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
        here, located = self.robots[robot], dict(self.located)
        d, companion = len(here.tangent), None
        disturbances, crossed = np.zeros((len(steps), PARTICLES, 6)), np.zeros((PARTICLES, d, 6))
        for disturbance, step in zip(disturbances, steps, strict=True):
            disturbance[:, here.tangent] = step[:, :d]
        for index, name in enumerate(cameras):
            rows = slice(d + 6 * index, d + 6 * index + 6)
            located[name] = replace(
                located[name],
                poses=located[name].poses.disturbed([step[:, rows] for step in steps]),
                covariance=symmetric(covariance[:, rows, rows]),
            )
            companion, crossed = name, covariance[:, :d, rows]
        poses, spread = here.poses.disturbed(disturbances), symmetric(covariance[:, :d, :d])
        there = RobotParticles(here.stamp_ns, here.tangent, poses, spread, companion, crossed)
        return replace(self, robots=self.robots | {robot: there}, located=located)

    def errors(self) -> list[Array]:
        """Each particle's disturbances of the robots and the cameras, and its scale errors, by part
        (n, …)."""
        parts = [here.poses.disturbances[:, here.tangent] for here in self.robots.values()]
        parts += [camera.poses.disturbances for camera in self.located.values()]
        return [*parts, *self.scale_errors.values()]

    def resampled(self, shown: Array, weights: Array) -> Self:
        """Equally likely particles in place of weighted ones."""
        parts = self.errors()
        errors = np.concatenate(parts, axis=1)
        drawn, indices = resampled(errors, shown, weights, self.random())
        split = iter(np.split(drawn, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1))
        robots = {}
        for name, here in self.robots.items():
            disturbance = np.zeros((PARTICLES, 6))
            disturbance[:, here.tangent] = next(split)
            poses = PoseSamples(here.poses.about, disturbance)
            spread, crossed = here.spread[indices], here.crossed[indices]
            robots[name] = replace(here, poses=poses, spread=spread, crossed=crossed)
        located = {
            name: CameraParticles(
                PoseSamples(each.poses.about, next(split)), each.covariance[indices], each.lens
            )
            for name, each in self.located.items()
        }
        scale_errors = {name: next(split) for name in self.scale_errors}
        return replace(
            self, draws=self.draws + 1, robots=robots, located=located, scale_errors=scale_errors
        )

    def without_robot(self, robot: str) -> Self:
        robots = {name: here for name, here in self.robots.items() if name != robot}
        return replace(self, robots=robots)


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
