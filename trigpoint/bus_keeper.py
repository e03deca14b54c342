"""Renews a connection that has been broken for long and does not mend itself.

Zenoh connects again by itself, but it does not notice a transport that lost one of its links, nor
one to a router that is gone. (In an hour with 5 % of loss and a router killed every three minutes,
corrections went without datagrams for most of the time after an overload.)
"""

import logging
import threading
import time
from collections.abc import Callable

from .ending import ENDING
from .errors import BusError

_log = logging.getLogger(__name__)

LOST_S = 5.0
"""What Zenoh can mend by itself is back by then: it tries again each second."""
_MOST_S = 60.0
_GROWTH = 2.0
_LOOKS = 5
"""Checks within the time in which it may be lost."""
_CLOSE_S = 15.0
"""A client whose router is gone took 10 s to close, all told."""


class Keeper:
    """A thread that renews what is not well, and waits twice as long after each attempt in vain.

    `is_well` and `renew` are called by that thread alone; `renew` raises BusError where it fails.
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
        """End the thread; whether it ended in time."""
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
    """Close something that may wait for a peer that is gone; where that takes too long it is left
    behind."""
    thread = threading.Thread(target=close, name=f"{what} closes", daemon=True)
    thread.start()
    thread.join(_CLOSE_S)
    if thread.is_alive():
        ENDING.leave_behind(what)
