"""The floor under the cameras in rerun: its plan, where what is surveyed says that it lies, and how
well a robot is corrected where."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.base.errors import InputError
from trigpoint.contract.messages import OccupancyGrid, PoseEstimate
from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building, lay_map
from trigpoint.map.floor_plan import FloorPlan
from trigpoint.site.config import Site

from . import style
from .columns import Columns
from .log import LogLine

_MOST_PIXELS = 4096
"""A side: what every graphics card takes as one texture."""
_PERIOD_NS = to_ns(5.0)
_BELOW_M = 0.02
"""Below the paths, so that the two do not flicker through each other."""
_CORRECTED_BELOW_M = 0.04
"""Below the plan too, which hides it: either can be switched off."""
_NEVER = 100


class BuildingScene:
    """Lays the site's plan under the map; anew as the cameras' poses come, at most every 5 s."""

    def __init__(self, site: Site, plan: FloorPlan | None, columns: Columns, log: LogLine) -> None:
        self._config, self._plan, self._columns, self._log = site.map, plan, columns, log
        self._places: dict[str, tuple[Array, Array]] = {}
        self._first_ns: dict[str, int] = {}
        self._laid_ns = 0
        self._is_new = False
        self._said = ""

    def announce(self) -> None:
        """Send the picture; where it lies comes later, unless the site file says it."""
        if self._plan is not None:
            self._columns.fixed(f"{style.PLAN}/picture", _mesh(self._plan.reduced(_MOST_PIXELS)))
        if self._config is not None and not self._config.points:
            self._send(lay_map(self._config, self._plan, {}, _no_covariance), None)

    def add_grid(self, grid: OccupancyGrid) -> None:
        """Show how well a robot is corrected where; the newest holds at every time."""
        if grid.values.size:
            self._columns.fixed(style.CORRECTED, _corrected(grid))

    def add_camera(self, camera: str, estimate: PoseEstimate) -> None:
        """Take a camera's pose, where it is one of the surveyed points."""
        if self._config is not None and camera in self._config.points:
            self._take(camera, estimate)

    def add_robot(self, robot: str, estimate: PoseEstimate) -> None:
        """Take a robot's pose at the moment when it stood on a mark."""
        if self._config is None:
            return
        first_ns = self._first_ns.setdefault(robot, estimate.stamp_ns)
        after_s = (estimate.stamp_ns - first_ns) / NANOSECONDS
        for name, point in self._config.points.items():
            if point.robot == robot and after_s >= point.at and name not in self._places:
                self._take(name, estimate)

    def finish(self, stamp_ns: int) -> None:
        """Lay it by all that came."""
        if self._is_new:
            self._lay(stamp_ns)

    def _take(self, name: str, estimate: PoseEstimate) -> None:
        covariance = estimate.covariance[:3, :3]
        self._places[name] = estimate.pose.translation, covariance
        self._is_new = True
        if estimate.stamp_ns - self._laid_ns >= _PERIOD_NS:
            self._lay(estimate.stamp_ns)

    def _lay(self, stamp_ns: int) -> None:
        assert self._config is not None  # else nothing is taken
        self._laid_ns, self._is_new = stamp_ns, False
        places = {name: place for name, (place, _) in self._places.items()}
        try:
            building = lay_map(self._config, self._plan, places, self._covariance)
        except InputError as reason:
            self._say(stamp_ns, "WARN", str(reason))
            return
        if building.laying is not None and building.laying.outliers:
            names = ", ".join(building.laying.outliers)
            self._say(stamp_ns, "WARN", f"{names}: contradicts the other surveyed points; left out")
        else:
            self._say(stamp_ns, "INFO", f"the map is laid over {building.frame}")
        self._send(building, stamp_ns)

    def _covariance(self, names: Sequence[str]) -> Array:
        """What the bus says: each camera's own, without what they have in common."""
        joint = np.zeros((3 * len(names), 3 * len(names)))
        for i, name in enumerate(names):
            joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = self._places[name][1]
        return joint

    def _send(self, building: Building, stamp_ns: int | None) -> None:
        if building.plan is None:
            return
        pose = building.frame_from_map.inverse() @ building.plan.frame_from_plan
        place = pose.translation - [0.0, 0.0, pose.translation[2] + _BELOW_M]
        if stamp_ns is None:
            still = rr.Transform3D(
                translation=place, quaternion=rr.Quaternion(xyzw=pose.quaternion)
            )
            self._columns.fixed(style.PLAN, still)
            return
        self._columns.row(
            style.PLAN,
            stamp_ns,
            rr.Transform3D,
            translation=[place],
            quaternion=[pose.quaternion],
        )

    def _say(self, stamp_ns: int, level: str, text: str) -> None:
        if text != self._said:
            self._said = text
            self._log(stamp_ns, level, text)


def _no_covariance(_: Sequence[str]) -> Array:
    return np.empty((0, 0))


def _mesh(plan: FloorPlan) -> rr.Mesh3D:
    """The picture on a rectangle in the plan's own frame: ink light on the dark floor."""
    ink = 255 - plan.pixels
    floor = np.array(style.FLOOR, dtype=float)
    shade = ink[..., None] / 255 * (np.array(style.WALL, dtype=float) - floor) + floor
    width, height = plan.size_m
    corners = np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    return _sheet(corners, shade.astype(np.uint8))


def _corrected(grid: OccupancyGrid) -> rr.Mesh3D:
    """From green, where a robot is corrected best, to brown, and red where it is not at all; what
    is not known to be floor has the background's colour."""
    rows, columns = grid.values.shape
    values = grid.values[::-1, :, None].astype(float)
    best, worst = np.array(style.BEST, dtype=float), np.array(style.WORST, dtype=float)
    shade = best + values / (_NEVER - 1) * (worst - best)
    shade = np.where(values == _NEVER, style.NEVER, shade)
    shade = np.where(values < 0, style.FLOOR, shade)
    width, height = columns * grid.cell_m, rows * grid.cell_m
    own = np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
    corners = grid.origin @ own - [0.0, 0.0, _CORRECTED_BELOW_M]
    step = -(-max(rows, columns) // _MOST_PIXELS)
    return _sheet(corners, shade[::step, ::step].astype(np.uint8))


def _sheet(corners: Array, texture: np.ndarray) -> rr.Mesh3D:
    """A picture (rows, columns, 3) on a rectangle (4, 3), counter-clockwise from its lower left."""
    return rr.Mesh3D(
        vertex_positions=corners,
        vertex_texcoords=[[0, 1], [1, 1], [1, 0], [0, 0]],
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        albedo_texture=texture,
        vertex_normals=[[0, 0, 1]] * 4,
    )
