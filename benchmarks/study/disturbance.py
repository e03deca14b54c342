"""What may be wrong in a simulated session beyond noise, and how it gets into a world.

Everything is drawn from the world's own random streams, so a seed always gives the same.
"""

import copy
from collections.abc import Mapping

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.compositions.carried import mounted
from benchmarks.compositions.room import one_to_one
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry import CameraModel, Pose
from trigpoint.site.target import Target
from trigpoint.tools.simulation.motion.actors import Lift, Move, SimulatedCamera, SimulatedRobot
from trigpoint.tools.simulation.motion.odometry import Way, chained, drawn_scales, scattered
from trigpoint.tools.simulation.world import Shown, World


class LensSpread(Struct, frozen=True):
    """Standard deviations of a camera's true lens about the one that is told: focal lengths
    (relative), principal point (of the width), each distortion coefficient."""

    focal: float
    centre: float
    distortion: float

    def sigmas(self, lens: CameraModel) -> np.ndarray:
        """Of `lens.parameters`."""
        centre = self.centre * lens.width
        focal = [self.focal * lens.fx, self.focal * lens.fy, centre, centre]
        return np.array([*focal, *([self.distortion] * len(lens.distortion))])


class Disturbance(Struct, frozen=True):
    """Nothing of it unless it is written.

    Of the world: `time_offset_s`, standard deviation of the cameras' time offsets; `lens`, of their
    lenses; `mount_m` and `mount_rad`, of each face's pose on its robot; `line_delay_s`, which all
    cameras have; `moves` and `lifts`, by camera and robot.

    Of the sightings: a `displaced_share` of them lies `displaced_px` off as a whole; of the corners
    a `wild_share` lies up to `wild_px` off; a `misnamed_share` is named as another face.
    `pictures`: the most pictures of a robot that a camera takes, by camera.

    Of the messages: a `twice_share` of the sightings comes twice, a `late_share` comes `late_s`
    late; odometry between the times of `gaps_s` is lost.
    """

    time_offset_s: float = 0.0
    line_delay_s: float = 0.0
    lens: LensSpread | None = None
    mount_m: float = 0.0
    mount_rad: float = 0.0
    moves: Mapping[str, tuple[Move, ...]] = field(default_factory=dict)
    lifts: Mapping[str, tuple[Lift, ...]] = field(default_factory=dict)
    displaced_share: float = 0.0
    displaced_px: float = 15.0
    wild_share: float = 0.0
    wild_px: float = 60.0
    misnamed_share: float = 0.0
    pictures: Mapping[str, int] = field(default_factory=dict)
    twice_share: float = 0.0
    late_share: float = 0.0
    late_s: float = 3.0
    gaps_s: tuple[tuple[float, float], ...] = ()


def disturbed(world: World, disturbance: Disturbance) -> World:
    """A copy of the world in which cameras and robots are as they truly are."""
    changed = copy.copy(world)
    changed.__dict__.pop("_odometry", None)  # it is drawn anew, of the changed robots
    changed.cameras = {n: _camera(world, c, disturbance) for n, c in world.cameras.items()}
    changed.robots = {n: _robot(world, r, disturbance) for n, r in world.robots.items()}
    skipped_s = [
        sum(lift.skip_s for lift in disturbance.lifts.get(name, ())) for name in world.robots
    ]
    changed.duration_s = world.duration_s - min(skipped_s)
    return changed


def with_ways(world: World) -> World:
    """A copy of the world in which the truth scatters about what is reported; see `way`."""
    changed = copy.copy(world)
    changed.__dict__.pop("_odometry", None)
    times_s = [camera.picture_times(world.duration_s) for camera in world.cameras.values()]
    changed.robots = {n: _scattered(world, r, times_s) for n, r in world.robots.items()}
    return changed


def _scattered(world: World, robot: SimulatedRobot, times_s: list[np.ndarray]) -> SimulatedRobot:
    random = world.random("way", robot.name)
    scale_errors = drawn_scales(robot.noise, random)
    messages_s = world.odometry(robot.name).stamps_s
    lifts_s = [lift.at_s for lift in robot.lifts]
    stamps_s = np.unique(np.concatenate([messages_s, lifts_s, *times_s]))
    stamps_s = stamps_s[stamps_s <= messages_s[-1]]
    steps = scattered(robot.steps(stamps_s), robot.noise, scale_errors, random)
    poses, first = [], 0
    # Whoever lifts it puts it down where its plan is, whatever it has drifted.
    for end in [*np.searchsorted(stamps_s, lifts_s).tolist(), len(stamps_s)]:
        poses.append(chained(robot.planned(stamps_s[first]), steps[first : end - 1]))
        first = end
    return replace(robot, way=Way(stamps_s, Pose.joined(poses), scale_errors))


def _camera(world: World, camera: SimulatedCamera, disturbance: Disturbance) -> SimulatedCamera:
    random = world.random("camera as it is", camera.name)
    offset_s = float(random.normal(0.0, 1.0)) * disturbance.time_offset_s
    told, spread = camera.model, disturbance.lens
    model = told if spread is None else one_to_one(lambda: _about(told, spread, random))
    moves = disturbance.moves.get(camera.name, ())
    line_delay_s = disturbance.line_delay_s or camera.line_delay_s
    return replace(
        camera, time_offset_s=offset_s, line_delay_s=line_delay_s, model=model, moves=moves
    )


def _about(told: CameraModel, spread: LensSpread, random: np.random.Generator) -> CameraModel:
    draw = random.standard_normal(len(told.parameters)) * spread.sigmas(told)
    return told.with_parameters(told.parameters + draw)


def _robot(world: World, robot: SimulatedRobot, disturbance: Disturbance) -> SimulatedRobot:
    lifts = disturbance.lifts.get(robot.name, ())
    if not disturbance.mount_m and not disturbance.mount_rad:
        return replace(robot, lifts=lifts)
    random = world.random("target as it is", robot.name)
    truly = mounted(robot.target, disturbance.mount_m, disturbance.mount_rad, random)
    return replace(robot, lifts=lifts, mounted=truly)


def disturbed_sighting(
    shown: Shown, target: Target, disturbance: Disturbance, random: np.random.Generator
) -> Shown:
    """What becomes of a sighting under a disturbance. `target`: the robot's."""
    sighting, is_good = shown.sighting, shown.is_good.copy()
    count = len(sighting.corners)
    # Drawn in any case, so that one share does not move what another one hits.
    chances, direction = random.random(2), _directions(1, random)
    wild, sizes = random.random(count), random.random(count) * _directions(count, random).T
    if chances[0] < disturbance.displaced_share:
        pixels = sighting.pixels + disturbance.displaced_px * direction
        sighting = _with_pixels(sighting, pixels)
        is_good[:] = False
    if np.any(hit := wild < disturbance.wild_share):
        pixels = sighting.pixels + disturbance.wild_px * sizes.T * hit[:, None]
        sighting = _with_pixels(sighting, pixels)
        is_good &= ~hit
    others = [face.id for face in target.faces if face.id != sighting.face]
    name = int(random.choice(others)) if others else sighting.face
    if sighting.face >= 0 and chances[1] < disturbance.misnamed_share:
        sighting = replace(sighting, face=name)
    return replace(shown, sighting=sighting, is_good=is_good)


def _directions(count: int, random: np.random.Generator) -> np.ndarray:
    """Unit vectors, (count, 2)."""
    angle = random.uniform(0.0, 2 * np.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _with_pixels(sighting: FaceSighting, pixels: np.ndarray) -> FaceSighting:
    return replace(sighting, pixels=pixels.astype(np.float32))
