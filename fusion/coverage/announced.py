"""When the map of corrections is worked out anew, for a network that changes while robots drive."""

from collections.abc import Callable, Mapping

import numpy as np

from trigpoint.contract.coverage import UNKNOWN
from trigpoint.contract.messages import OccupancyGrid
from trigpoint.fusion.model.places import are_near
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.site.config import Site
from trigpoint.site.target import Target

from .accuracy_map import accuracy_map, grid_values
from .floor import DRIVEN_M, each_decimetre, floor_of
from .known_network import KnownNetwork, carried_by, known_network

PERIOD_S = 15.0
"""The least time from one map to the next."""
MOST_CELLS = 60_000
"""24 m × 24 m of decimetres; a larger floor has larger cells, so that a map takes no longer."""
# A camera that moved by less sees the same cells, but for some at the edge; and a radius that
# changed by less is as good as before.
_SAME_M, _SAME_RAD, _SAME_SIGMA = 0.05, 0.01, 1.25


class AnnouncedMap:
    """The map that was announced last, and all that robots drove, also where the estimator has
    forgotten it. Not thread-safe."""

    def __init__(self, site: Site, targets: Mapping[str, Target]) -> None:
        self._site, self._targets = site, targets
        self._before: KnownNetwork | None = None
        self._driven = self._floor = np.zeros((0, 2))

    def anew(
        self,
        network: Network,
        covariance: Array,
        trajectories: Mapping[str, tuple[np.ndarray, Pose]],
        *,
        step: Callable[[int], None] = lambda _cells: None,
    ) -> OccupancyGrid | None:
        """The grid by a network and its joint covariance; None where no camera is located, or it
        differs from the last by no more than matters and nobody drove beyond the floor that is
        known. `step`: called often, as the work goes on."""
        if not network.located:
            return None
        known = known_network(network, covariance)
        ways = [poses.translation for _, poses in trajectories.values()]
        places = each_decimetre([self._driven, *ways])
        is_known = self._before is not None and not differs(self._before, known)
        if is_known and are_near(places, self._floor, DRIVEN_M).all():
            return None
        carried = carried_by(self._site.robots, self._targets, network)
        floor = floor_of(known, carried, places, most_cells=MOST_CELLS)
        if not floor.rows:
            return None
        maps = [accuracy_map(known, each, floor, places, step=step) for each in carried]
        stamp_ns = max((int(stamps[-1]) for stamps, _ in trajectories.values()), default=0)
        values = grid_values(maps)
        self._before, self._driven = known, places
        self._floor = np.concatenate([places, floor.centres[values != UNKNOWN]])
        origin, shape = Pose.planar(*floor.origin, 0.0), (floor.rows, floor.columns)
        return OccupancyGrid(stamp_ns, "map", floor.cell_m, origin, values.reshape(shape))


def differs(before: KnownNetwork, now: KnownNetwork) -> bool:
    """Whether two networks have other cameras, or any at another place or known otherwise."""
    if before.names != now.names:
        return True
    for number, (old, new) in enumerate(zip(before.eyes, now.eyes, strict=True)):
        change = np.abs(new.map_from_camera.difference(old.map_from_camera))
        rows = slice(6 * number, 6 * number + 6)
        sizes = [np.diagonal(known.covariance[rows, rows]) for known in (before, now)]
        for part, same in ((slice(0, 3), _SAME_M), (slice(3, 6), _SAME_RAD)):
            was, is_now = (float(np.sqrt(size[part].sum())) for size in sizes)
            if change[part].max() > same or max(was, is_now) > _SAME_SIGMA * min(was, is_now):
                return True
    return False
