"""What a day of the page's server leaves in memory: a site whose clock runs as fast as it is read.

The reader, its history and its alarms are the server's; a small site says everything once a second,
and a robot is in trouble every other minute.
"""

import gc
import threading
from functools import partial

from support.builders import make_site
from support.site.board_site import BoardSite, Truth

from benchmarks.table import Row
from benchmarks.timing import in_new_process, resident_mb
from trigpoint.base.clock import ManualClock, to_ns, to_seconds
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.board.feed import Feed
from trigpoint.tools.board.history import History
from trigpoint.tools.board.pictures import Pictures
from trigpoint.tools.board.reader import Reader

_CAMERAS, _ROBOTS = 4, 2
_BEGIN_S = 1_000_000.0
_SECOND_S, _MINUTE_S, _YOUNG_S, _HOUR_S = 1.0, 60.0, 600.0, 3600.0
_row = partial(Row, "page")


class _Day(ManualClock):
    """Says what is due whenever somebody waits, until it is over; `memory_mb`: after ten minutes,
    and in the end."""

    def __init__(self, hours: float) -> None:
        super().__init__(to_ns(_BEGIN_S))
        self._end_s = _BEGIN_S + hours * _HOUR_S
        self._young_s = _BEGIN_S + _YOUNG_S
        self.site: BoardSite | None = None
        self.memory_mb: list[float] = []

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        self.advance(max(_SECOND_S, timeout_s))
        now_s = to_seconds(self.now_ns())
        if self.site is not None:
            is_troubled = now_s // _MINUTE_S % 2 > 0
            self.site.troubles = {"robot/r1": f"no port {now_s:.0f}"} if is_troubled else {}
            self.site.announce(now_s)
            self.site.move(now_s)
        if now_s >= (self._end_s if self.memory_mb else self._young_s):
            gc.collect()
            self.memory_mb.append(resident_mb("self"))
            if now_s >= self._end_s:
                event.set()
        return event.is_set()


def day(hours: float) -> list[Row]:
    """The server's memory after so many hours, against that after ten minutes."""
    young_mb, old_mb = in_new_process(_lived, hours)
    what = f"server's memory after {hours:g} hours of a fast clock"
    return [_row(what, "MB", old_mb, young_mb, "after ten minutes")]


def _lived(hours: float) -> tuple[float, float]:
    site, clock = make_site(cameras=_CAMERAS, robots=_ROBOTS), _Day(hours)
    broker = MemoryBroker(clock)
    with broker.session() as speaking, broker.session() as bus:
        clock.site = BoardSite(speaking, site, Truth(_CAMERAS, _ROBOTS))
        clock.site.cover()
        pictures = Pictures(lambda: bus, site.name, frozenset(site.cameras))
        reader = Reader(site, Feed(), History(), pictures, about={}, clock=clock)
        reader.begin()
        reader.run(bus, threading.Event())
    young_mb, old_mb = clock.memory_mb
    return young_mb, old_mb
