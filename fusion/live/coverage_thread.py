"""Works out the map of corrections beside what must not wait for it, and announces it."""

from collections.abc import Callable

from trigpoint.contract.messages import OccupancyGrid
from trigpoint.fusion.coverage.announced import PERIOD_S, AnnouncedMap
from trigpoint.fusion.estimators.results import Results


def cover(
    announced: AnnouncedMap,
    results: Callable[[], Results | None],
    say: Callable[[OccupancyGrid], None],
    *,
    wait: Callable[[float], bool | None],
    beat: Callable[[], None] = lambda: None,
) -> None:
    """Work the grid out from the results of now, None where those are nothing yet, and say it where
    it changed; on a thread of its own, until `wait` says that it waits in vain. `beat`: called
    often."""
    while True:
        beat()
        found = results()
        if found is not None:
            network, covariance, paths = found.network, found.covariance, found.trajectories
            grid = announced.anew(network, covariance, paths, step=lambda _cells: beat())
            if grid is not None:
                say(grid)
        if wait(PERIOD_S):
            return
