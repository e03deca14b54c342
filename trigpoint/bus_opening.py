"""What opening a session takes besides opening it: patience, and knowing who is there."""

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from .bus import Bus
from .bus_settings import Settings
from .errors import BusError

_log = logging.getLogger(__name__)

_RETRY_S = 1.0
_SETTLE_S = 0.2
_SETTLE_LIMIT_S = 1.0

Session = TypeVar("Session")


def open_patiently(
    open_session: Callable[[], Session], settings: Settings, patience_s: float
) -> Session:
    """Open a session; a client that reaches nobody tries again for `patience_s`.

    Peers need no patience: they open at once and connect when they can.
    """
    deadline = time.monotonic() + patience_s
    is_said = False
    while True:
        try:
            return open_session()
        except BusError as reason:
            if settings.mode != "client" or time.monotonic() > deadline:
                raise
            if not is_said:
                _log.warning("%s; check that it runs; trying again", reason)
            is_said = True
        time.sleep(_RETRY_S)


def settle(bus: Bus) -> None:
    """Wait until the peers that are there have told of each other, so that a first look at who is
    alive is complete: without, four of ten newcomers overlooked their double."""
    deadline = time.monotonic() + _SETTLE_LIMIT_S
    peers, since = bus.peers, time.monotonic()
    while (now := time.monotonic()) < deadline and now - since < _SETTLE_S:
        time.sleep(0.02)
        if bus.peers != peers:
            peers, since = bus.peers, time.monotonic()
