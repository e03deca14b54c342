"""A hall without inner walls, whose cameras see the same floor from several sides, and a robot that
drives through all of it; and its network as `calibrate` finds it."""

from pathlib import Path

from trigpoint.contract.messages import Odometry
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.site.config import (
    BusConfig,
    CameraConfig,
    FusionConfig,
    RecorderConfig,
    RobotConfig,
    Site,
)
from trigpoint.tools.simulation.disturbance import Disturbance
from trigpoint.tools.simulation.in_memory import simulated
from trigpoint.tools.simulation.world import World
from trigpoint.tools.simulation.world_file import CameraSpec, RobotSpec, TargetChoice, WorldFile

_PLACES = (
    ((0.0, 0.0), 45.0),
    ((5.0, 0.0), 90.0),
    ((10.0, 0.0), 135.0),
    ((10.0, 7.0), 225.0),
    ((5.0, 7.0), 270.0),
    ((0.0, 7.0), 315.0),
    ((2.5, 3.5), 0.0),
    ((7.5, 3.5), 180.0),
)
_DRIVE = (
    *((1.0, 1.0), (9.0, 1.0), (9.0, 2.7), (1.0, 2.7), (1.0, 4.4), (9.0, 4.4), (9.0, 6.0)),
    *((1.0, 6.0), (1.0, 1.0), (2.7, 1.0), (2.7, 6.0), (5.0, 6.0), (5.0, 1.0), (7.3, 1.0)),
    *((7.3, 6.0), (3.0, 3.5)),
)


def hall(seed: int, target: TargetChoice) -> World:
    """The hall, 10 m × 7 m, with eight cameras at 2.6 m."""
    cameras = {
        f"c{number}": CameraSpec(
            position=(*place, 2.6),
            yaw=yaw,
            pitch=32.0 + 2 * number,
            width=1280,
            height=960,
            distortion=(-0.2, 0.05, 0.0005, -0.0005, -0.005),
            horizontal_fov=65.0,
            rate=1.0,
            phase=0.1 * number,
        )
        for number, (place, yaw) in enumerate(_PLACES, start=1)
    }
    robot = RobotSpec(waypoints=_DRIVE, speed=0.5, target=target, odometry_start=(1.0, 1.0, 0.0))
    file = WorldFile("hall", cameras=cameras, robots={"r1": robot}, hold_first=1.0, hold_last=0.5)
    return World("hall", file, seed=seed, target=target)


def inputs_of(world: World) -> Inputs:
    """What an estimator is told of a world: its lenses, and its robots' odometry noise."""
    cameras = {
        name: CameraConfig(f"sim://{name}", camera.model.width, camera.model.height)
        for name, camera in world.cameras.items()
    }
    site = Site(
        name="hall",
        cameras=cameras,
        robots={n: RobotConfig("loop://", odometry=r.noise) for n, r in world.robots.items()},
        bus=BusConfig(),
        fusion=FusionConfig(),
        recorder=RecorderConfig(),
        directory=Path(),
        text="",
        default_target="target.toml",
    )
    targets = {robot: world.target(robot) for robot in world.robots}
    return Inputs(site, targets, {n: camera.model for n, camera in world.cameras.items()})


def calibrated(world: World) -> tuple[Inputs, Results]:
    """A drive through the world, worked out as `calibrate` does."""
    inputs = inputs_of(world)
    pipeline = Pipeline(inputs, is_live=False)
    for node, message in simulated(world, Disturbance()).messages:
        pipeline.push(node, message)
        if isinstance(message, Odometry):
            pipeline.advance()
    pipeline.finish()
    return inputs, pipeline.results()
