"""Keeps a machine's door to the network open, whichever of its processes lives."""

import logging
import threading
from collections.abc import Callable

from .bus import Closable
from .errors import BusError

_log = logging.getLogger(__name__)

_JOIN_S = 2.0

_RETRY_S = 2.0
_TAKEN = "Address already in use"


class Gate:
    """Holds the session that listens on `[bus] listen`, or stands by while another process does.

    Every process of a machine that reads the same site file has one; the port lets only one in.
    When that process ends, another takes the port within two seconds, and clients connect again.
    """

    def __init__(self, names: tuple[str, ...], open_session: Callable[[], Closable]) -> None:
        self._names, self._open_session = ", ".join(names), open_session
        self._stopping = threading.Event()
        self._session: Closable | None = None
        self._try()
        self._thread = threading.Thread(target=self._run, name=f"gate {self._names}", daemon=True)
        self._thread.start()

    @property
    def is_open(self) -> bool:
        """Whether this process is the one that listens."""
        return self._session is not None

    def close(self) -> None:
        """Close the door and end the thread."""
        self._stopping.set()
        self._thread.join(_JOIN_S)
        if self._thread.is_alive():
            _log.error("the gate %s did not close in %.0f s", self._thread.name, _JOIN_S)
        if self._session is not None:
            self._session.close()
            self._session = None

    def _run(self) -> None:
        if self._session is None:
            _log.info("another process listens on %s; this one stands by", self._names)
        while self._session is None and not self._stopping.wait(_RETRY_S):
            try:
                self._try()
            except BusError as reason:
                _log.error("%s; trying again", reason)

    def _try(self) -> None:
        """Open the session unless the port is taken; raise BusError for any other reason."""
        try:
            self._session = self._open_session()
        except BusError as reason:
            if _TAKEN not in str(reason):
                raise
        else:
            _log.info("listening on %s", self._names)
