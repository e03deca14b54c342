"""Lays the map in its building while poses still come, as a live view needs it."""

from collections.abc import Sequence

import numpy as np

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.base.errors import InputError
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import MapConfig

from .building import Building, lay_map
from .floor_plan import FloorPlan

_PERIOD_NS = to_ns(5.0)


class LiveLaying:
    """Collects where surveyed cameras and marks are in the map, and lays it by them.

    Covariances are each point's own: the bus does not say what they have in common.
    """

    def __init__(self, config: MapConfig | None, plan: FloorPlan | None) -> None:
        self._config, self._plan = config, plan
        self._places: dict[str, tuple[Array, Array]] = {}
        self._first_ns: dict[str, int] = {}
        self._laid_ns = 0
        self._is_new = False

    def given(self) -> Building | None:
        """Where the map lies by the site file alone; None where that takes surveyed points."""
        if self._config is None or self._config.points:
            return None
        return lay_map(self._config, self._plan, {}, self._covariance)

    def take_camera(self, camera: str, position: Array, covariance: Array) -> None:
        """Take a camera's position (3,) with its covariance (3, 3), if it is a surveyed point."""
        if self._config is not None and camera in self._config.points:
            self._take(camera, position, covariance)

    def take_robot(self, robot: str, stamp_ns: int, position: Array, covariance: Array) -> None:
        """Take a robot's position at the moment when it stood on a mark."""
        if self._config is None:
            return
        first_ns = self._first_ns.setdefault(robot, stamp_ns)
        after_s = (stamp_ns - first_ns) / NANOSECONDS
        for name, point in self._config.points.items():
            if point.robot == robot and after_s >= point.at and name not in self._places:
                self._take(name, position, covariance)

    def laid(self, stamp_ns: int, *, at_once: bool = False) -> Building | InputError | None:
        """The map laid anew, or why it cannot be; None where nothing new came or, unless
        `at_once`, it was laid less than five seconds ago."""
        if not self._is_new or (not at_once and stamp_ns - self._laid_ns < _PERIOD_NS):
            return None
        assert self._config is not None  # else nothing is taken
        self._laid_ns, self._is_new = stamp_ns, False
        places = {name: place for name, (place, _) in self._places.items()}
        try:
            return lay_map(self._config, self._plan, places, self._covariance)
        except InputError as reason:
            return reason

    def _take(self, name: str, position: Array, covariance: Array) -> None:
        self._places[name] = position, covariance
        self._is_new = True

    def _covariance(self, names: Sequence[str]) -> Array:
        joint = np.zeros((3 * len(names), 3 * len(names)))
        for i, name in enumerate(names):
            joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = self._places[name][1]
        return joint
