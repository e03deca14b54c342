"""The map of how well robots would be corrected: for each cell of the floor and each heading.

A robot stands in a cell; every camera that sees it takes one picture. What is stated of a cell is
for the middle heading: in more than half of the headings it is so good or better.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from msgspec import Struct

from trigpoint.contract.coverage import MOST_MM, NOT_CORRECTED, UNKNOWN
from trigpoint.fusion.reading.sight import information_at
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique

from .correction_errors import Pictures, expected_errors
from .floor import DRIVEN_M, HEADINGS, Floor, standing
from .known_network import Carried, KnownNetwork

NOBODY = -1
WITHIN_M = (0.01, 0.02, 0.05, 0.10, math.inf)
"""Classes of accuracy; the last: corrected at all."""

BY_FAILURE_M = (0.05, math.inf)
"""Those of them by which it is told what a camera's failure costs."""


def class_name(within_m: float) -> str:
    """«within 5 cm», «at all»."""
    return f"within {100 * within_m:g} cm" if math.isfinite(within_m) else "at all"


class AccuracyMap(Struct, frozen=True, eq=False):
    """Of the robots that carry one target, by cell (n) of the floor: radii within which 95 % of
    the errors of a corrected position lie, metres, inf where nothing corrects.

    `by_heading` (n, h); `cameras` (n, h): how many see a robot; `sees` (c, n): whether camera c
    does in some heading; `without` (c, n): in the middle heading, where camera c fails; `is_floor`
    (n): whether the cell is known to be floor.
    """

    robots: tuple[str, ...]
    floor: Floor
    names: tuple[str, ...]
    by_heading: Array
    cameras: np.ndarray
    sees: np.ndarray
    without: Array
    is_floor: np.ndarray

    @property
    def error_m(self) -> Array:
        """In the middle heading, (n,)."""
        return middle(self.by_heading)

    @property
    def best_m(self) -> Array:
        """In the best heading, (n,)."""
        return self.by_heading.min(axis=1)

    @property
    def worst_m(self) -> Array:
        """In the worst heading, (n,)."""
        return self.by_heading.max(axis=1)

    @property
    def usual_cameras(self) -> np.ndarray:
        """How many cameras see a robot in more than half of the headings, (n,)."""
        return np.sort(self.cameras, axis=1)[:, (self.cameras.shape[1] - 1) // 2]

    @property
    def worst_camera(self) -> np.ndarray:
        """The number of the camera whose failure costs a cell most, NOBODY where none costs
        anything; (n,)."""
        if not len(self.names):
            return np.full(len(self.is_floor), NOBODY)
        return np.where(self.without_worst_m > self.error_m, self.without.argmax(axis=0), NOBODY)

    @property
    def without_worst_m(self) -> Array:
        """In the middle heading, where the camera fails whose failure costs most, (n,)."""
        return np.maximum(self.without.max(axis=0, initial=0.0), self.error_m)

    def area_m2(self, within_m: float, *, failing: bool = False) -> float:
        """Of the floor that is corrected to within so much, in the middle heading; `failing`: also
        where any one camera fails."""
        errors = self.without_worst_m if failing else self.error_m
        return self._size_m2(_is_within(errors, within_m))

    def lost_m2(self, camera: int, within_m: float) -> float:
        """Of the area that is corrected to within so much, what is not without a camera."""
        kept = _is_within(self.without[camera], within_m)
        return self._size_m2(_is_within(self.error_m, within_m) & ~kept)

    def seen_m2(self, camera: int) -> float:
        """The floor on which a camera sees a robot in some heading."""
        return self._size_m2(self.sees[camera])

    def failures_m2(self) -> Iterator[tuple[str, tuple[float, ...]]]:
        """Of each camera what it sees, and what is lost without it, by BY_FAILURE_M."""
        for index, name in enumerate(self.names):
            lost = (self.lost_m2(index, within_m) for within_m in BY_FAILURE_M)
            yield name, (self.seen_m2(index), *lost)

    @property
    def floor_m2(self) -> float:
        """All that is known to be floor."""
        return self._size_m2(self.is_floor)

    def _size_m2(self, cells: np.ndarray) -> float:
        return self.floor.area_m2 * int(np.sum(cells & self.is_floor))


def _is_within(errors_m: Array, within_m: float) -> np.ndarray:
    """Whether errors are so small; an infinite bound asks whether there is a correction at all."""
    return np.isfinite(errors_m) & (errors_m <= within_m)


def middle(by_heading: Array) -> Array:
    """The error of the middle heading: more than half (n, h) have none that is larger; (n,)."""
    return np.sort(by_heading, axis=1)[:, by_heading.shape[1] // 2]


def accuracy_map(
    network: KnownNetwork,
    carried: Carried,
    floor: Floor,
    driven: Array,
    *,
    wanted: np.ndarray | None = None,
    step: Callable[[int], None] = lambda _cells: None,
) -> AccuracyMap:
    """The map of the robots that carry a target; `driven` (m, 2): where any robot drove.

    `wanted` (n,): the cells that are asked for, which then are the floor; `step` is told how many
    cells are done.
    """
    centres = floor.centres
    by_heading = np.full((len(centres), HEADINGS), np.inf)
    cameras = np.zeros((len(centres), HEADINGS), dtype=np.int16)
    without = np.full((len(network.eyes), len(centres)), np.inf)
    sees = np.zeros(without.shape, dtype=bool)
    for tile in floor.tiles():
        cells = tile if wanted is None else tile[wanted[tile]]
        by_heading[cells], cameras[cells], sees[:, cells], without[:, cells] = _tile(
            network, carried, centres[cells]
        )
        step(len(tile))
    is_floor = wanted
    if is_floor is None:
        is_floor = np.isfinite(by_heading).any(axis=1) | floor.near(driven, DRIVEN_M)
    names = network.names
    return AccuracyMap(carried.robots, floor, names, by_heading, cameras, sees, without, is_floor)


def _tile(
    network: KnownNetwork, carried: Carried, places: Array
) -> tuple[Array, np.ndarray, np.ndarray, Array]:
    """`by_heading`, `cameras`, `sees` and `without` of some cells, as in AccuracyMap."""
    pictures = _pictures(network, carried, places)
    poses = len(places) * HEADINGS
    errors = expected_errors(pictures, poses, network.covariance, carried.tangent)
    whole = errors.by_pose.reshape(-1, HEADINGS)
    cameras = np.bincount(pictures.pose, minlength=poses).reshape(-1, HEADINGS)
    without = np.tile(middle(whole), (len(network.eyes), 1))
    sees = np.zeros(without.shape, dtype=bool)
    for camera in unique(pictures.camera):
        mine = pictures.camera == camera
        failed = errors.by_pose.copy()
        failed[pictures.pose[mine]] = errors.without[mine]
        without[camera] = middle(failed.reshape(-1, HEADINGS))
        sees[camera, pictures.pose[mine] // HEADINGS] = True
    return whole, cameras, sees, without


def _pictures(network: KnownNetwork, carried: Carried, places: Array) -> Pictures:
    """The pictures of a robot at places (n, 2) in each heading."""
    pose, camera, information, arm = [], [], [], []
    for number, eye in enumerate(network.eyes):
        near = np.flatnonzero(eye.may_see(carried.faces, places))
        if not len(near):
            continue
        bases = standing(places[near])
        told = information_at(eye, carried.faces, bases)
        pose.append(near[told.rows // HEADINGS] * HEADINGS + told.rows % HEADINGS)
        camera.append(np.full(len(told.rows), number))
        information.append(told.information)
        arm.append(bases.translation[told.rows] - eye.map_from_camera.translation)
    if not pose:
        nothing = np.zeros(0, dtype=int)
        return Pictures(nothing, nothing, np.zeros((0, 6, 6)), np.zeros((0, 3)))
    found = Pictures(*(np.concatenate(part) for part in (pose, camera, information, arm)))
    return found.where(np.argsort(found.pose, kind="stable"))


def grid_values(maps: Sequence[AccuracyMap]) -> np.ndarray:
    """Maps as a planner takes them: the values (n,) int8 of all cells, row by row from the lower
    left. Whole millimetres of the error radius in the middle heading, MOST_MM for all that is
    larger; NOT_CORRECTED where a robot is not corrected, UNKNOWN where nothing says that the cell
    is floor. Of several targets, the one that is corrected worst."""
    errors = np.max([each.error_m for each in maps], axis=0)
    is_floor = np.any([each.is_floor for each in maps], axis=0)
    millimetres = np.floor(1000 * np.where(np.isfinite(errors), errors, 0.0))
    values = np.where(np.isfinite(errors), np.minimum(millimetres, MOST_MM), NOT_CORRECTED)
    return np.where(is_floor, values, UNKNOWN).astype(np.int8)
