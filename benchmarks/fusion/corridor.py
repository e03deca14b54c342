"""A drive through a long corridor with many cameras, made without pictures and in little time.

The corridor is a ring: robots drive along it once, or several times, and every camera sees each for
a few metres. Cameras do not overlap but for neighbours.
"""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import CameraInfo, FaceSighting, Odometry, Sightings
from trigpoint.fusion.inbox import Input
from trigpoint.fusion.pipeline import Inputs
from trigpoint.geometry import CameraModel, Pose
from trigpoint.site.config import OdometryNoise, parse_site
from trigpoint.site.target import Target
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.motion.odometry import chained, increments, reported
from trigpoint.tools.simulation.session import EPOCH_NS
from trigpoint.tools.simulation.sight.seen_corners import seen_faces
from trigpoint.tools.simulation.sight.targets import target_of

SPEED = 0.4
DAY_NS = to_ns(24 * 3600.0)
ODOMETRY_HZ = 20.0
PICTURES_HZ = 5.0
_SPACING_M = 3.5
_SEES_M = 3.2
_SIGMA_PX = 0.25
_FEWEST_CORNERS = 8
_SITE = 'site = "corridor"\n{cameras}\n{robots}\n'
_ROBOT = '[robots.{0}]\nport = "sim"\ntarget = "{0}.toml"\n'
_CAMERA = '[cameras.c{}]\nsource = "sim://c{}"\nwidth = 640\nheight = 480\nrate = 5.0\n'


class Corridor(Struct, frozen=True):
    """`cameras` of them on a ring, driven along for `duration_s`. `robots`: spread along it, each
    with a target of its own; `is_empty_told`: whether cameras that see none say so; `stands_s`: for
    how long they then stand where they arrived."""

    cameras: int
    duration_s: float
    robots: int = 1
    pictures_hz: float = PICTURES_HZ
    odometry_hz: float = ODOMETRY_HZ
    is_empty_told: bool = False
    stands_s: float = 0.0

    @property
    def radius_m(self) -> float:
        return _SPACING_M * self.cameras / (2 * np.pi)

    @property
    def lap_s(self) -> float:
        """How long once round takes."""
        return _SPACING_M * self.cameras / SPEED

    @property
    def measured_from_s(self) -> float:
        """Where what a session costs begins to count: where the robots stand, or the second lap
        where that is reached."""
        if self.stands_s:
            return self.duration_s
        return self.lap_s if self.lap_s < self.duration_s else 0.0

    @property
    def inputs(self) -> Inputs:
        cameras = "\n".join(_CAMERA.format(i, i) for i in range(self.cameras))
        robots = "\n".join(map(_ROBOT.format, self.targets))
        site = parse_site(_SITE.format(cameras=cameras, robots=robots), directory=Path())
        return Inputs(site, self.targets)

    @property
    def targets(self) -> dict[str, Target]:
        """Robot -> its target."""
        target = target_of("charuco")
        if self.robots == 1:
            return {"r1": target}
        numbers = range(1, self.robots + 1)
        return {f"r{n}": msgspec.structs.replace(target, name=f"{target.name}{n}") for n in numbers}

    def messages(self, *, seed: int = 0, later_ns: int = 0) -> Iterator[tuple[str, Input]]:
        """(camera or robot, message) in the order of their stamps, from so long after the epoch
        on."""
        random, targets = np.random.default_rng(seed), self.targets
        lens = CameraModel.from_field_of_view(640, 480, np.radians(62.0))
        places = [self.camera(index) for index in range(self.cameras)]
        for index in range(self.cameras):
            name = f"c{index}"
            yield name, CameraInfo(EPOCH_NS + later_ns, f"{name}/optical", lens)
        every = round(self.odometry_hz / self.pictures_hz)
        driven = round(self.duration_s * self.odometry_hz)
        told = {name: self._reported(driven, random) for name in targets}
        for step in range(driven + round(self.stands_s * self.odometry_hz)):
            stamp_ns = EPOCH_NS + later_ns + round(step * 1e9 / self.odometry_hz)
            for name, poses in told.items():
                pose, still = poses[min(step, driven - 1)], np.zeros(3)
                yield name, Odometry(stamp_ns, f"{name}/odom", f"{name}/base", pose, still, still)
            if step % every == 0:
                seconds = min(step, driven) / self.odometry_hz
                for index, faces in self._seen(seconds, lens, places, random):
                    name = f"c{index}"
                    yield name, Sightings(stamp_ns, f"{name}/optical", 640, 480, faces)

    def _seen(
        self, seconds: float, lens: CameraModel, places: list[Pose], random: np.random.Generator
    ) -> Iterator[tuple[int, tuple[FaceSighting, ...]]]:
        """(camera, faces) of one moment's pictures."""
        found: dict[int, tuple[FaceSighting, ...]] = {}
        for number, target in enumerate(self.targets.values()):
            robot = self._robot(seconds, number)
            for index in self._near(robot):
                faces = _sighted(lens, places[index], robot, target, random)
                found[index] = found.get(index, ()) + faces
        if self.is_empty_told:
            found = dict.fromkeys(range(self.cameras), ()) | found
        for index, faces in sorted(found.items()):
            if faces or self.is_empty_told:
                yield index, faces

    def _robot(self, seconds: float | np.ndarray, number: int) -> Pose:
        """map_from_base: anticlockwise from the origin along x; the others ahead of the first."""
        turn = SPEED * seconds / self.radius_m + 2 * np.pi * number / self.robots
        return Pose.planar(self.radius_m * np.sin(turn), self.radius_m * (1 - np.cos(turn)), turn)

    def _reported(self, count: int, random: np.random.Generator) -> Pose:
        """What a robot's odometry says of its way round, with the contract's default noise."""
        truth = self._robot(np.arange(count) / self.odometry_hz, 0)
        noisy = reported(increments(truth), OdometryNoise(), np.zeros(2), random)
        return chained(Pose.identity(), noisy)

    def camera(self, index: int) -> Pose:
        """map_from_camera: above the outer edge, looking along the corridor and down."""
        turn = 2 * np.pi * (index + 0.5) / self.cameras
        outside = np.array([np.sin(turn), -np.cos(turn), 0.0])
        ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
        centre = np.array([0.0, self.radius_m, 0.0])
        eye = centre + (self.radius_m + 1.2) * outside + [0.0, 0.0, 1.6]
        look = -0.8 * outside - ahead - [0.0, 0.0, 0.55]
        return looking_at(eye, eye + look)

    def _near(self, robot: Pose) -> list[int]:
        """The cameras that may see the robot: those around it on the ring."""
        x, y, _ = robot.translation
        turn = np.arctan2(x, self.radius_m - y) % (2 * np.pi)
        here = int(turn / (2 * np.pi) * self.cameras)
        reach = range(here - 2, here + 3)
        return sorted({index % self.cameras for index in reach})


def _sighted(
    lens: CameraModel,
    map_from_camera: Pose,
    robot: Pose,
    target: Target,
    random: np.random.Generator,
) -> tuple[FaceSighting, ...]:
    if np.linalg.norm(robot.translation - map_from_camera.translation) > _SEES_M:
        return ()
    return tuple(
        seen.sighting(target, target.name, pixels, _SIGMA_PX)
        for seen in seen_faces(target, robot, map_from_camera, lens, ())
        if len(seen.corners) >= _FEWEST_CORNERS
        for pixels in [seen.pixels + random.normal(scale=_SIGMA_PX, size=seen.pixels.shape)]
    )
