"""Works out the map of corrections beside what must not wait for it, and announces it."""

import os
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract import cdr
from trigpoint.contract.messages import OccupancyGrid
from trigpoint.contract.topics import COVERAGE_GRID
from trigpoint.fusion.coverage.announced import PERIOD_S, AnnouncedMap
from trigpoint.fusion.estimators.results import Results
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse

_NICENESS = 10


class CoverageWork:
    """A thread that takes the newest results it is given, at most every PERIOD_S, and says the grid
    where it changed. It ends with its process."""

    def __init__(self, announced: AnnouncedMap, say: Callable[[OccupancyGrid], None]) -> None:
        self._announced, self._say = announced, say
        self._newest: queue.Queue[Results] = queue.Queue(maxsize=1)
        threading.Thread(target=self._run, name="fusion coverage", daemon=True).start()

    def take(self, results: Results) -> None:
        """Take results in place of those that wait still; never waits. Called by one thread."""
        with suppress(queue.Empty):
            self._newest.get_nowait()
        self._newest.put_nowait(results)

    def _run(self) -> None:
        # Of this thread alone: on Linux priorities are threads' own.
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        while True:
            found = self._newest.get()
            grid = self._announced.anew(found.network, found.covariance, found.trajectories)
            if grid is not None:
                self._say(grid)
            time.sleep(PERIOD_S)


class CoverageThread:
    """The same for estimators that solve within their turns: asks for results itself.

    `results`: gives what is known now, None where that is nothing yet, under whatever lock that
    needs.
    """

    def __init__(
        self,
        bus: Bus,
        node: Node,
        site: str,
        announced: AnnouncedMap,
        results: Callable[[], Results | None],
    ) -> None:
        self._bus, self._node, self._results = bus, node, results
        self._key = COVERAGE_GRID.key(site)
        self._announced = announced
        self._publisher: Publisher | None = None

    def run(self, pulse: Pulse) -> None:
        """Run until the node ends, on a thread of its own, and beat the pulse."""
        while not self._node.stopping.wait(PERIOD_S):
            pulse.beat()
            found = self._results()
            if found is None:
                continue
            grid = self._announced.anew(
                found.network,
                found.covariance,
                found.trajectories,
                step=lambda _cells: pulse.beat(),
            )
            if grid is not None:
                self._publish(grid)

    def _publish(self, grid: OccupancyGrid) -> None:
        if self._publisher is None:
            self._publisher = self._bus.publisher(COVERAGE_GRID, self._key)
        self._publisher.put(cdr.encode(grid))
        self._node.health.count(f"sent {self._key}")
