"""A simulated world: where everything truly is, as a pure function of the file and the seed.

World time starts at 0 and is in seconds. The map is the first robot's odometry frame: at its first
message the truth is what the odometry says. Every random number comes from a stream of its own,
named by the seed, by what it is for and by whom, so that nothing depends on the order of calls.
"""

import itertools
import zlib
from functools import cached_property
from typing import TypeVar

import numpy as np
from msgspec import Struct, structs
from msgspec.structs import replace
from numpy.typing import ArrayLike

from trigpoint.base.errors import InputError
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, exp
from trigpoint.site.target import Target

from .motion.actors import SimulatedCamera, SimulatedRobot
from .motion.odometry import OdometryLog, chained, drawn_scales, reported
from .motion.path import Drive, rounded_path
from .sight.seen_corners import SeenFace, Wall, seen_faces_each, told_name
from .sight.targets import target_of
from .world_file import CameraSpec, RobotSpec, WorldFile, load_world_file

_Item = TypeVar("_Item")
# Each round is nearer by the robot's motion in the picture over the readout's, below 1 in 100.
_ROLLED_ROUNDS = 4


class Shown(Struct, frozen=True, eq=False):
    """A sighting, and what an oracle knows of it: the robot's face, by the half turn where
    `is_turned`, and which corners (n,) bool have nothing but their noise."""

    sighting: FaceSighting
    robot: str
    face: int
    is_turned: bool
    is_good: np.ndarray


class World:
    """A loaded world; see `load_world`."""

    def __init__(self, name: str, file: WorldFile, *, seed: int, target: str | None) -> None:
        self.name, self.seed, self.target_choice = name, seed, target
        self.site_name = file.site or name
        self.smallest_square_px = file.smallest_square
        drives = {robot: _drive(spec, file.hold_first) for robot, spec in file.robots.items()}
        self.duration_s = max(drive.end_s for drive in drives.values()) + file.hold_last
        first = next(iter(file.robots))
        start = Pose.planar(*file.robots[first].odometry_start)
        self.map_from_plan = start @ drives[first].at(0.0).inverse()
        self.walls = _walls(file, self.map_from_plan)
        self.cameras = {
            camera: _camera(camera, spec, self.map_from_plan, file.picture_rate)
            for camera, spec in file.cameras.items()
        }
        targets = {robot: target_of(target or spec.target) for robot, spec in file.robots.items()}
        self.robots = {
            robot: _robot(robot, file.robots[robot], drives[robot], self.map_from_plan, carried)
            for robot, carried in _named_apart(targets).items()
        }

    @property
    def first_robot(self) -> str:
        """The robot whose odometry frame is the map."""
        return next(iter(self.robots))

    def camera(self, name: str) -> SimulatedCamera:
        """A camera by name; raise InputError that lists the known ones."""
        return _pick(self.cameras, name, "camera", self.name)

    def robot(self, name: str) -> SimulatedRobot:
        """A robot by name; raise InputError that lists the known ones."""
        return _pick(self.robots, name, "robot", self.name)

    def target(self, robot: str) -> Target:
        return self.robot(robot).target

    def map_from_base(self, robot: str, t_s: ArrayLike) -> Pose:
        """A robot's true pose at world time `t_s` (one, or (n,)); it stands before and after."""
        return self.robot(robot).map_from_base(t_s)

    def odometry(self, robot: str) -> OdometryLog:
        """Everything that a robot's odometry reports, in its own odometry frame."""
        return self._odometry[self.robot(robot).name]

    def seen(self, camera: str, robot: str, t_s: float) -> list[SeenFace]:
        """The faces of a robot that show a camera their front, with the corners in sight."""
        return self.seen_each(camera, robot, np.array([t_s]))[0]

    def seen_each(self, camera: str, robot: str, times_s: Array) -> list[list[SeenFace]]:
        """`seen` at each of many world times (n,), rising."""
        eye, shown = self.camera(camera), self.robot(robot)
        others = [other for name, other in self.robots.items() if name != robot]
        found = []
        for part_s in eye.between_moves(times_s):
            faces = seen_faces_each(
                shown.carried,
                shown.map_from_base(part_s),
                eye.map_from_camera_at(float(part_s[0])),
                eye.model,
                self.walls,
                tuple((other.carried, other.map_from_base(part_s)) for other in others),
            )
            for t_s, seen in zip(part_s.tolist(), faces, strict=True):
                found.append([_rolled(face, eye, shown, t_s) for face in seen])
        return found

    def sightings(self, camera: str, t_s: float) -> tuple[FaceSighting, ...]:
        """What a good detector finds at world time `t_s`, simulated without a picture."""
        seen = {robot: self.seen(camera, robot, t_s) for robot in self.robots}
        return tuple(shown.sighting for shown in self.shown(camera, t_s, seen))

    def shown(self, camera: str, t_s: float, seen: dict[str, list[SeenFace]]) -> list[Shown]:
        """The sightings, and what they show, of the faces that are `seen` of each robot."""
        random = self.random("sightings", camera, round(t_s * 1e6))
        found = []
        for robot, faces in seen.items():
            for face in faces:
                shown = self._shown(face, robot, self.camera(camera).sigma, random)
                if shown is not None:
                    found.append(shown)
        return found

    def random(self, purpose: str, owner: str, index: int = 0) -> np.random.Generator:
        names = [zlib.crc32(text.encode()) for text in (purpose, owner)]
        return np.random.default_rng([self.seed, *names, index])

    @cached_property
    def _odometry(self) -> dict[str, OdometryLog]:
        return {name: self._reported(robot) for name, robot in self.robots.items()}

    def _reported(self, robot: SimulatedRobot) -> OdometryLog:
        count = int(np.floor(self.duration_s * robot.odometry_rate)) + 1
        stamps_s = np.arange(count) / robot.odometry_rate
        if robot.way is not None:
            steps = robot.steps(stamps_s)
            return OdometryLog(
                stamps_s, chained(robot.odometry_start, steps), robot.way.scale_errors
            )
        random = self.random("odometry", robot.name)
        scales = drawn_scales(robot.noise, random)
        noisy = reported(robot.steps(stamps_s), robot.noise, scales, random)
        return OdometryLog(stamps_s, chained(robot.odometry_start, noisy), scales)

    def _shown(
        self, seen: SeenFace, robot: str, sigma: float, random: np.random.Generator
    ) -> Shown | None:
        face = seen.face
        # Drawn in any case, so that one face's fate does not move another's noise.
        noise = random.normal(0.0, sigma, (face.corner_count, 2))
        turned = face.reads_from_both_ends and random.random() < 0.5
        if not seen.is_found(self.smallest_square_px):
            return None
        pixels = seen.pixels + noise[seen.corners]
        target = self.target(robot)
        name = told_name(target, (self.target(other) for other in self.robots if other != robot))
        sighting = seen.sighting(target, name, pixels[:: -1 if turned else 1], sigma)
        is_good = np.ones(len(sighting.corners), dtype=bool)
        return Shown(sighting, robot, face.id, turned, is_good)


def load_world(name_or_path: str, *, seed: int, target: str | None = None) -> World:
    """A named world (`lab`, `drive`, `loop`, `dance`) or a world file.

    `target` (`charuco` or `checkerboard`) replaces what the file lets the robots carry. Raises
    InputError in one line.
    """
    if target not in (None, "charuco", "checkerboard"):
        raise InputError(f"there is no target «{target}»; choose charuco or checkerboard")
    if seed < 0:
        raise InputError(f"the seed is {seed}; it must be 0 or more")
    file = load_world_file(name_or_path)
    try:
        return World(name_or_path, file, seed=seed, target=target)
    except ValueError as reason:
        raise InputError(f"the world «{name_or_path}»: {reason}") from None


def _drive(spec: RobotSpec, start_s: float) -> Drive:
    path = rounded_path(spec.waypoints, spec.corner_radius)
    return Drive(path, spec.speed, spec.acceleration, start_s)


def _named_apart(targets: dict[str, Target]) -> dict[str, Target]:
    """The robots' targets; where they differ, each with its robot's name in its own."""
    if all(target == next(iter(targets.values())) for target in targets.values()):
        return targets
    return {
        robot: structs.replace(target, name=f"{target.name}-{robot}")
        for robot, target in targets.items()
    }


def _robot(
    name: str, spec: RobotSpec, drive: Drive, map_from_plan: Pose, target: Target
) -> SimulatedRobot:
    return SimulatedRobot(
        name=name,
        target=target,
        drive=drive,
        map_from_plan=map_from_plan,
        odometry_rate=spec.odometry_rate,
        odometry_start=Pose.planar(*spec.odometry_start),
        noise=spec.odometry,
    )


def _camera(
    name: str, spec: CameraSpec, map_from_plan: Pose, picture_rate: float | None
) -> SimulatedCamera:
    plan_from_camera = Pose(looking(spec.yaw, spec.pitch, spec.roll), np.array(spec.position))
    return SimulatedCamera(
        name=name,
        map_from_camera=map_from_plan @ plan_from_camera,
        model=_model(spec),
        rate=picture_rate or spec.rate,
        phase=spec.phase,
        exposure_s=spec.exposure,
        line_delay_s=spec.line_delay,
        blur_px=spec.blur,
        noise=spec.noise,
        sigma=spec.sigma,
    )


def looking(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Array:
    """Axes (3, 3) of a camera that looks to azimuth `yaw`, `pitch` below the horizon, then
    rolls."""
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    forward = np.cos(pitch) * level - np.sin(pitch) * np.array([0.0, 0.0, 1.0])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    upright = np.column_stack([right, np.cross(forward, right), forward])
    return upright @ exp([0.0, 0.0, roll])


def _model(spec: CameraSpec) -> CameraModel:
    fov_rad = np.radians(spec.horizontal_fov)
    plain = CameraModel.from_field_of_view(spec.width, spec.height, float(fov_rad))
    cx, cy = plain.cx + spec.centre_offset[0], plain.cy + spec.centre_offset[1]
    return CameraModel(spec.width, spec.height, plain.fx, plain.fy, cx, cy, spec.distortion)


def _rolled(face: SeenFace, camera: SimulatedCamera, robot: SimulatedRobot, t_s: float) -> SeenFace:
    """A face as it is seen while the rows of the picture of world time `t_s` are exposed: each
    corner lies on the row that is exposed as it passes there."""
    if camera.line_delay_s == 0 or not len(face.corners):
        return face
    in_base = face.face.base_from_face @ face.face.corners[face.corners]
    camera_from_map = camera.map_from_camera_at(t_s).inverse()
    pixels = face.pixels
    for _ in range(_ROLLED_ROUNDS):
        rows_s = t_s + camera.row_delay_s(pixels[:, 1])
        camera_from_base = camera_from_map @ robot.map_from_base(rows_s)
        points = (camera_from_base.rotation @ in_base[..., None])[..., 0]
        pixels = camera.model.project(points + camera_from_base.translation)
    return replace(face, pixels=pixels)


def _walls(file: WorldFile, map_from_plan: Pose) -> tuple[Wall, ...]:
    walls = []
    for spec in file.walls:
        points = np.array([[x, y, 0.0] for x, y in spec.points])
        corners = (map_from_plan @ points)[:, :2]
        for start, end in itertools.pairwise(corners):
            walls.append(Wall(start, end, spec.height, spec.shade))
    return tuple(walls)


def _pick(items: dict[str, _Item], name: str, kind: str, world: str) -> _Item:
    if name not in items:
        known = ", ".join(items)
        raise InputError(f"there is no {kind} «{name}» in the world «{world}»; it has {known}")
    return items[name]
