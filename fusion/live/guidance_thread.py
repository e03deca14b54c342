"""Sends suggestions beside the estimator's thread, so that no correction waits for one."""

from collections.abc import Callable

from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract import cdr
from trigpoint.contract.messages import PoseStamped
from trigpoint.contract.topics import SUGGESTION
from trigpoint.fusion.guidance.suggestions import suggestions
from trigpoint.fusion.solver.snapshot import GuidanceWorld
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse


class GuidanceThread:
    """Works out where each robot should go next, every few seconds.

    `world`: gives a copy of what is known now, under whatever lock that needs.
    """

    def __init__(
        self,
        bus: Bus,
        node: Node,
        site: str,
        world: Callable[[], GuidanceWorld | None],
        *,
        period_s: float = 3.0,
    ) -> None:
        self._bus, self._node, self._site, self._world = bus, node, site, world
        self._period_s = period_s
        self._publishers: dict[str, Publisher] = {}

    def run(self, pulse: Pulse) -> None:
        """Run until the node ends, on a thread of its own, and beat the pulse."""
        while not self._node.stopping.wait(self._period_s):
            pulse.beat()
            world = self._world()
            for robot in world.robots if world is not None else ():
                pulse.beat()
                if self._node.stopping.is_set():
                    return
                assert world is not None
                self._suggest(world, robot)

    def _suggest(self, world: GuidanceWorld, robot: str) -> None:
        for suggestion in suggestions(world, robot):
            key = SUGGESTION.key(self._site, robot)
            if robot not in self._publishers:
                self._publishers[robot] = self._bus.publisher(SUGGESTION, key)
            stamp_ns = world.robots[robot].stamp_ns
            message = PoseStamped(stamp_ns, "map", suggestion.map_from_base)
            self._publishers[robot].put(cdr.encode(message))
            self._node.health.count(f"sent {key}")
