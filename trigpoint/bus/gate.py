"""Keeps a machine's network endpoint open as long as any of its processes runs."""

import logging
import threading
from collections.abc import Callable

from trigpoint.base.errors import BusError, TrigpointError

from .bus import Closable

_log = logging.getLogger(__name__)

_JOIN_S = 2.0

_RETRY_S = 2.0
_TAKEN = "Address already in use"


class Gate:
    """Holds the session that listens on `[bus] listen`, or stands by while another process does.

    Every process on a machine that reads the same site file has a gate; only one can get the port.
    When that process ends, another takes the port within two seconds, and clients reconnect. When
    the rules change, the session is closed, which ends every link, and opened with the new rules.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        open_session: Callable[[], Closable],
        *,
        rules: Callable[[], object] | None = None,
    ) -> None:
        """`rules`: a value that stands for the admission rules; the session is closed and opened
        again when it changes. None: everyone is admitted."""
        self._names, self._open_session = ", ".join(names), open_session
        self._rules = rules
        self._current = rules() if rules else None
        self._stopping = threading.Event()
        self._session: Closable | None = None
        self._try()
        self._thread = threading.Thread(target=self._run, name=f"gate {self._names}", daemon=True)
        self._thread.start()

    @property
    def is_open(self) -> bool:
        """Whether this process is the one listening."""
        return self._session is not None

    def close(self) -> None:
        """Close the session and end the thread."""
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
        while not self._is_settled and not self._stopping.wait(_RETRY_S):
            try:
                self._look_at_rules()
                if self._session is None:
                    self._try()
            except TrigpointError as reason:
                _log.error("%s; trying again", reason)

    @property
    def _is_settled(self) -> bool:
        """Whether nothing is left to do: the port is open, and the rules will not change."""
        return self._session is not None and self._rules is None

    def _look_at_rules(self) -> None:
        if self._rules is None or (now := self._rules()) == self._current:
            return
        self._current = now
        if self._session is not None:
            _log.info("who may come in has changed; %s is opened anew", self._names)
            session, self._session = self._session, None
            session.close()

    def _try(self) -> None:
        """Open the session unless the port is taken; raise BusError if it fails otherwise."""
        try:
            self._session = self._open_session()
        except BusError as reason:
            if _TAKEN not in str(reason):
                raise
        else:
            _log.info("listening on %s", self._names)
