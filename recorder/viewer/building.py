"""The floor under the cameras in rerun: its plan, where what is surveyed says that it lies, and how
well a robot is corrected where."""

import numpy as np
import rerun as rr

from trigpoint.base.errors import InputError
from trigpoint.contract.coverage import MOST_MM, NOT_CORRECTED, UNKNOWN
from trigpoint.contract.messages import OccupancyGrid, PoseEstimate
from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building
from trigpoint.map.floor_plan import FloorPlan
from trigpoint.map.live_laying import LiveLaying
from trigpoint.site.config import Site

from . import style
from .columns import Columns
from .log import LogLine

_MOST_PIXELS = 4096
"""A side: what every graphics card takes as one texture."""
_BELOW_M = 0.02
"""Below the paths, so that the two do not flicker through each other."""
_CORRECTED_BELOW_M = 0.04
"""Below the plan too, which hides it: either can be switched off."""


class BuildingScene:
    """Lays the site's plan under the map; anew as the cameras' poses come, at most every 5 s."""

    def __init__(self, site: Site, plan: FloorPlan | None, columns: Columns, log: LogLine) -> None:
        self._laying, self._plan = LiveLaying(site.map, plan), plan
        self._columns, self._log = columns, log
        self._said = ""

    def announce(self) -> None:
        """Send the picture; where it lies comes later, unless the site file says it."""
        if self._plan is not None:
            self._columns.fixed(f"{style.PLAN}/picture", _mesh(self._plan.reduced(_MOST_PIXELS)))
        if (building := self._laying.given()) is not None:
            self._send(building, None)

    def add_grid(self, grid: OccupancyGrid) -> None:
        """Show how well a robot is corrected where; the newest holds at every time."""
        if grid.values.size:
            self._columns.fixed(style.CORRECTED, _corrected(grid))

    def add_camera(self, camera: str, estimate: PoseEstimate) -> None:
        """Take a camera's pose, where it is one of the surveyed points."""
        self._laying.take_camera(camera, estimate.pose.translation, estimate.covariance[:3, :3])
        self._lay(estimate.stamp_ns)

    def add_robot(self, robot: str, estimate: PoseEstimate) -> None:
        """Take a robot's pose at the moment when it stood on a mark."""
        place, covariance = estimate.pose.translation, estimate.covariance[:3, :3]
        self._laying.take_robot(robot, estimate.stamp_ns, place, covariance)
        self._lay(estimate.stamp_ns)

    def finish(self, stamp_ns: int) -> None:
        """Lay it by all that came."""
        self._lay(stamp_ns, at_once=True)

    def _lay(self, stamp_ns: int, *, at_once: bool = False) -> None:
        building = self._laying.laid(stamp_ns, at_once=at_once)
        if building is None:
            return
        if isinstance(building, InputError):
            self._say(stamp_ns, "WARN", str(building))
            return
        if building.laying is not None and building.laying.outliers:
            names = ", ".join(building.laying.outliers)
            self._say(stamp_ns, "WARN", f"{names}: contradicts the other surveyed points; left out")
        else:
            self._say(stamp_ns, "INFO", f"the map is laid over {building.frame}")
        self._send(building, stamp_ns)

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


def _mesh(plan: FloorPlan) -> rr.Mesh3D:
    """The picture on a rectangle in the plan's own frame: ink light on the dark floor."""
    ink = 255 - plan.pixels
    floor = np.array(style.FLOOR, dtype=float)
    shade = ink[..., None] / 255 * (np.array(style.WALL, dtype=float) - floor) + floor
    return _sheet(_rectangle(*plan.size_m), shade.astype(np.uint8))


def _corrected(grid: OccupancyGrid) -> rr.Mesh3D:
    """From green, where a robot is corrected best, to brown, and red where it is not at all; what
    is not known to be floor has the background's colour."""
    rows, columns = grid.values.shape
    step = -(-max(rows, columns) // _MOST_PIXELS)
    values = grid.values[::-step, ::step, None].astype(float)
    best, worst = np.array(style.BEST, dtype=float), np.array(style.WORST, dtype=float)
    shade = best + values / MOST_MM * (worst - best)
    shade = np.where(values == NOT_CORRECTED, style.NEVER, shade)
    shade = np.where(values == UNKNOWN, style.FLOOR, shade)
    own = _rectangle(columns * grid.cell_m, rows * grid.cell_m)
    corners = grid.origin @ own - [0.0, 0.0, _CORRECTED_BELOW_M]
    return _sheet(corners, shade.astype(np.uint8))


def _rectangle(width: float, height: float) -> Array:
    """Its corners (4, 3), counter-clockwise from the lower left at the origin."""
    return np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])


def _sheet(corners: Array, texture: np.ndarray) -> rr.Mesh3D:
    """A picture (rows, columns, 3) on a rectangle (4, 3), counter-clockwise from its lower left."""
    return rr.Mesh3D(
        vertex_positions=corners,
        vertex_texcoords=[[0, 1], [1, 1], [1, 0], [0, 0]],
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        albedo_texture=texture,
        vertex_normals=[[0, 0, 1]] * 4,
    )
