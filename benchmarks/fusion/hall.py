"""A hall without inner walls, whose cameras see the same floor from several sides, and a robot that
drives through all of it; and its network as `calibrate` finds it."""

from benchmarks.study.disturbance import Disturbance
from benchmarks.study.in_memory import simulated
from benchmarks.study.session import fed, plain_inputs
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.model.inputs import Inputs
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


def calibrated(world: World) -> tuple[Inputs, Results]:
    """A drive through the world, worked out as `calibrate` does."""
    inputs = plain_inputs(world)
    return inputs, fed(inputs, simulated(world, Disturbance()).messages).results()
