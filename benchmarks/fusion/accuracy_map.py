"""Whether robots are corrected as well as the map of that says.

`python -m benchmarks accuracy_map [--cells N] [--times K] [--target T]` calibrates a simulated hall
of eight cameras, which see the same floor from several sides; then it draws cells and headings, and
for each of them where the cameras truly are, from the network's own joint covariance; shows the
robot to them by the simulated lab's rules; and lets fusion's alignment and filter correct it by
those sightings and the network. Errors are held against the radius that the map states for the
cell, and the cameras that see the robot against those that it says can't be done without.

Each cell is drawn several times. The 95 % quantile of n errors along a line is known to 0.95/√n of
itself: a robot is corrected in four or six of ten cells, so of 10,000 that are drawn once a class
has 200 or 300, and one or two of twenty classes are off by a tenth where the map is exact.
"""

from collections.abc import Iterator
from functools import partial
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct

from benchmarks.study.disturbance import Disturbance
from benchmarks.study.in_memory import simulated
from benchmarks.study.session import fed, inputs_of
from benchmarks.table import Row
from trigpoint.fusion.coverage.correction_errors import Pictures, expected_errors
from trigpoint.fusion.coverage.floor import HEADINGS, floor_of, headings_rad
from trigpoint.fusion.coverage.known_network import (
    Carried,
    KnownNetwork,
    carried_by,
    known_network,
)
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.pipeline import Inputs
from trigpoint.fusion.reading.sight import information_at
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.tools.simulation.world import World
from trigpoint.tools.simulation.world_file import CameraSpec, RobotSpec, TargetChoice, WorldFile

from .drawn_corrections import Corrector, sightings

_SIGMA_PX = 0.15
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
_BINS = 20
_row = partial(Row, "accuracy_map")
_more = partial(_row, more_is_better=True)


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
    inputs = inputs_of(world)
    return inputs, fed(inputs, simulated(world, Disturbance()).messages).results()


class Drawn(Struct, frozen=True, eq=False):
    """Cells (n), one as often as it was drawn. `stated_m`: the radius by the map, `error_m`: the
    error made, both inf where there is no correction; `needs`, `needed`: the number of the camera
    without which there is none, by the map and in the simulation, -1 where none is; `cameras`: how
    many see the robot."""

    stated_m: Array
    error_m: Array
    needs: np.ndarray
    needed: np.ndarray
    cameras: np.ndarray

    @property
    def ratios(self) -> Array:
        """Error over stated radius, of those that are corrected, (k,)."""
        both = np.isfinite(self.stated_m) & np.isfinite(self.error_m)
        return self.error_m[both] / self.stated_m[both]

    @property
    def losses_right(self) -> float:
        """The share of cells for which the map names the camera, or none, that is needed."""
        return float(np.mean(self.needs == self.needed))

    def by_class(self, bins: int = _BINS) -> Array:
        """The 95 % quantile of error over stated radius, in classes of equal size of that radius;
        (bins,)."""
        both = np.isfinite(self.stated_m) & np.isfinite(self.error_m)
        order = np.argsort(self.stated_m[both], kind="stable")
        parts = np.array_split(self.ratios[order], bins)
        return np.array([np.quantile(part, 0.95) for part in parts])


def drawn(inputs: Inputs, results: Results, cells: int, seed: int, times: int = 1) -> Drawn:
    """Draw cells of the network's floor, and the cameras' errors in each so many times."""
    random = np.random.default_rng(seed)
    network = known_network(results.network, results.covariance)
    [carried] = carried_by(inputs.site.robots, inputs.targets, results.network)
    places, headings = _drawn_places(network, carried, cells, random)
    corrector = Corrector(inputs.data_set(), network, carried.robots[0])
    base = Pose.planar(places[:, 0], places[:, 1], headings_rad()[headings])
    stated, needs, cameras = (np.tile(e, times) for e in _stated(network, carried, base))
    realised = [_realised(network, carried, corrector, base, random) for _ in range(times)]
    error, needed = (np.concatenate(parts) for parts in zip(*realised, strict=True))
    return Drawn(stated, error, needs, needed, cameras)


def _realised(
    network: KnownNetwork,
    carried: Carried,
    corrector: Corrector,
    base: Pose,
    random: np.random.Generator,
) -> tuple[Array, np.ndarray]:
    """`error_m` and `needed` of robots at poses (n), the cameras' errors drawn for each."""
    off = _errors(network, len(base), random)
    shown = sightings(carried.faces.target, base, network.eyes, off, _SIGMA_PX, random)
    error, needed = np.full(len(base), np.inf), np.full(len(base), -1)
    for row in range(len(base)):
        if len(shown[row]) == 1:
            needed[row] = network.names.index(next(iter(shown[row])))
        found = corrector.corrected(base[row], shown[row], random)
        if found is not None:
            error[row] = np.linalg.norm(found.translation[:2] - base[row].translation[:2])
    return error, needed


def _errors(network: KnownNetwork, cells: int, random: np.random.Generator) -> Array:
    """By how much each camera is off by the network's joint covariance, (cells, cameras, 6)."""
    values, vectors = np.linalg.eigh(network.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return (random.normal(size=(cells, len(root))) @ root.T).reshape(cells, -1, 6)


def _drawn_places(
    network: KnownNetwork, carried: Carried, cells: int, random: np.random.Generator
) -> tuple[Array, np.ndarray]:
    """Middles of cells (n, 2) of the floor that some camera may see, and headings by number."""
    floor = floor_of(network, (carried,), np.zeros((0, 2)))
    near = np.stack([eye.may_see(carried.faces, floor.centres) for eye in network.eyes]).any(axis=0)
    chosen = random.choice(np.flatnonzero(near), cells)
    return floor.centres[chosen], random.integers(HEADINGS, size=cells)


def _stated(
    network: KnownNetwork, carried: Carried, base: Pose
) -> tuple[Array, np.ndarray, np.ndarray]:
    """What the map says: the radius, the one camera that is needed, and how many see the robot."""
    parts: list[tuple[np.ndarray, ...]] = []
    for number, eye in enumerate(network.eyes):
        told = information_at(eye, carried.faces, base)
        arm = base.translation[told.rows] - eye.map_from_camera.translation
        parts.append((told.rows, np.full(len(told.rows), number), told.information, arm))
    pictures = Pictures(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    pictures = pictures.where(np.argsort(pictures.pose, kind="stable"))
    errors = expected_errors(pictures, len(base), network.covariance, carried.tangent)
    counts = np.bincount(pictures.pose, minlength=len(base))
    needs = np.full(len(base), -1)
    alone = counts[pictures.pose] == 1
    needs[pictures.pose[alone]] = pictures.camera[alone]
    return errors.by_pose, needs, counts


def rows_of(found: Drawn) -> Iterator[Row]:
    """What came out."""
    classes = found.by_class()
    within = float(np.mean((classes >= 0.9) & (classes <= 1.1)))
    corrected = np.isfinite(found.error_m)
    is_as_said = np.isfinite(found.stated_m) == corrected
    yield _more("corrected", "times", corrected.sum(), len(found.stated_m), "drawn")
    yield _more("corrected or not as the map says", "%", 100 * is_as_said.mean(), 100.0, "all")
    yield _row("95 % of the errors", "radii", float(np.quantile(found.ratios, 0.95)), 1.0, "stated")
    what = f"the same, in {len(classes)} classes by that radius"
    yield _row(f"{what}, least", "radii", classes.min(), 1.0, "stated")
    yield _row(f"{what}, most", "radii", classes.max(), 1.0, "stated")
    yield _more("classes within 0.9 to 1.1", "%", 100 * within, 95.0, "the goal")
    yield _more("the needed camera named", "%", 100 * found.losses_right, 99.0, "the goal")
    for count in range(1, int(found.cameras.max()) + 1):
        mine = (found.cameras == count) & corrected & np.isfinite(found.stated_m)
        if mine.sum() >= 100:
            ratio = float(np.quantile(found.error_m[mine] / found.stated_m[mine], 0.95))
            median_mm = 1000 * np.median(found.stated_m[mine])
            what = f"95 % of the errors, seen by {count}, of {median_mm:.2f} mm in the middle"
            yield _row(what, "radii", ratio, 1.0, f"stated, {mine.sum()} times")


def main(
    cells: Annotated[int, typer.Option(min=1, help="How many are drawn.")] = 10_000,
    times: Annotated[int, typer.Option(min=1, help="How often each is.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the drawing.")] = 1,
    target: Annotated[TargetChoice, typer.Option(help="What the robot carries.")] = "charuco",
) -> list[Row]:
    """Hold drawn errors against the map."""
    return list(rows_of(drawn(*calibrated(hall(1, target)), cells, seed, times)))
