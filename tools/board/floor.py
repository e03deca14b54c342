"""The floor plan under the page's map: its picture, and where it lies."""

import io

import numpy as np

from trigpoint.base.errors import InputError
from trigpoint.contract.messages import PoseEstimate
from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building, load_plan
from trigpoint.map.live_laying import LiveLaying
from trigpoint.site.config import Site

from .entities import Fields

_MOST_PIXELS = 1200
"""A side; walls are still seen, and the picture of a hall has some tens of kilobytes."""


class Floor:
    """Raises ConfigError where the site's plan cannot be read. `picture`: PNG; "" without one."""

    def __init__(self, site: Site) -> None:
        plan = load_plan(site)
        self._plan = None if plan is None else plan.reduced(_MOST_PIXELS)
        self._laying = LiveLaying(site.map, plan)
        self._building = self._laying.given()
        self._trouble = ""
        self.picture = b"" if self._plan is None else _png(self._plan.pixels)

    def take(self, kind: str, name: str, message: PoseEstimate) -> None:
        """Take the pose of a camera or robot, by which the map may be laid anew."""
        place, covariance = message.pose.translation, message.covariance[:3, :3]
        if kind == "camera":
            self._laying.take_camera(name, place, covariance)
        else:
            self._laying.take_robot(name, message.stamp_ns, place, covariance)
        laid = self._laying.laid(message.stamp_ns)
        if isinstance(laid, InputError):
            self._trouble = str(laid)
        elif laid is not None:
            self._building, self._trouble = laid, ""

    @property
    def fields(self) -> Fields:
        """`matrix`: the picture's columns and rows to x, y of the map, as SVG orders them."""
        found: Fields = {"trouble": self._trouble}
        if self._plan is not None and self._building is not None:
            rows, columns = self._plan.pixels.shape
            found |= {"size": [columns, rows], "matrix": self._matrix(self._building)}
        return found

    def _matrix(self, building: Building) -> list[float]:
        assert self._plan is not None
        rows, columns = self._plan.pixels.shape
        corners = building.frame_from_map.inverse() @ self._plan.corners
        return matrix(corners[[0, 1, 3], :2], columns, rows)


def matrix(corners: Array, columns: int, rows: int) -> list[float]:
    """A picture's columns and rows to x, y of the map, as SVG orders them; `corners` (3, 2): its
    lower left, lower right and upper left."""
    low, right, top = corners
    across, down = (right - low) / columns, (low - top) / rows
    return [round(float(value), 6) for value in (*across, *down, *top)]


def _png(pixels: np.ndarray) -> bytes:
    from PIL import Image  # with the site's plan alone

    data = io.BytesIO()
    Image.fromarray(pixels).quantize(16).save(data, "png", optimize=True)
    return data.getvalue()
