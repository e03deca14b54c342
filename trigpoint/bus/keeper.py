"""Renews a connection that has long been broken and does not recover by itself.

Zenoh reconnects by itself, but it does not notice a transport that has lost one of its links, or
one to a router that is gone. (In an hour with 5 % packet loss and a router killed every three
minutes, corrections went without datagrams for most of the time after an overload.)
"""

import logging
import threading
import time
from collections.abc import Callable

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import BusError

_log = logging.getLogger(__name__)

LOST_S = 2.0
"""By then Zenoh has recovered what it can: it tries every second. A QUIC link to a router that was
killed, though, it holds for ten."""
_MOST_S = 60.0
_GROWTH = 2.0
_LOOKS = 5
"""Number of checks in the time for which it may be lost."""
_CLOSE_S = 15.0
"""A client whose router was gone took 10 s in all to close."""


class Keeper:
    """A thread that renews a broken connection, waiting twice as long after each failed attempt.

    `is_well` and `renew` are called only on that thread; `renew` raises BusError if it fails.
    """

    def __init__(
        self,
        name: str,
        is_well: Callable[[], bool],
        renew: Callable[[], None],
        *,
        lost_s: float = LOST_S,
    ) -> None:
        self._is_well, self._renew, self._lost_s = is_well, renew, lost_s
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self, timeout_s: float) -> bool:
        """End the thread; return whether it ended in time."""
        self._closing.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        well_s, wait_s = time.monotonic(), self._lost_s
        while not self._closing.wait(self._lost_s / _LOOKS):
            if self._is_well():
                well_s, wait_s = time.monotonic(), self._lost_s
            elif time.monotonic() - well_s >= wait_s:
                try:
                    self._renew()
                except BusError as reason:
                    _log.info("%s; trying again later", reason)
                well_s, wait_s = time.monotonic(), min(_GROWTH * wait_s, _MOST_S)


def close_in_time(close: Callable[[], object], what: str) -> None:
    """Close something that may wait for a vanished peer; if that takes too long, leave it
    behind."""
    thread = threading.Thread(target=close, name=f"{what} closes", daemon=True)
    thread.start()
    thread.join(_CLOSE_S)
    if thread.is_alive():
        ENDING.leave_behind(what)
