"""Answers queries on a thread of ours; both buses use it."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol

from trigpoint.base.errors import TrigpointError

_log = logging.getLogger(__name__)

_CAPACITY = 64
_JOIN_S = 1.0


class Request(Protocol):
    """A query waiting for its answer."""

    @property
    def payload(self) -> bytes: ...

    def reply(self, payload: bytes) -> None: ...

    def refuse(self, error: str) -> None: ...


class Server:
    """One thread that answers the requests for one key, in order.

    `submit` may be called from any thread and only appends. When the queue is full, the request is
    dropped and its sender times out.
    """

    undeclare: Callable[[], None]
    """Withdraws the declaration that brings the requests; set by the bus."""

    def __init__(self, key: str, answer: Callable[[bytes], bytes]) -> None:
        self.key = key
        self.undeclare = lambda: None
        self._answer = answer
        self._requests: deque[Request] = deque()
        self._changed = threading.Condition(threading.Lock())
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=f"serve {key}", daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Hand a request to the thread; called on the bus's thread."""
        with self._changed:
            if not self._is_closed and len(self._requests) < _CAPACITY:
                self._requests.append(request)
                self._changed.notify()

    def close(self) -> None:
        """Withdraw the declaration and end the thread."""
        with self._changed:
            if self._is_closed:
                return
            self._is_closed = True
            self._requests.clear()
            self._changed.notify()
        self.undeclare()
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN_S)
        if self._thread.is_alive():
            _log.error("the answer to a query on %s still runs; it was left behind", self.key)

    def _run(self) -> None:
        while (request := self._next()) is not None:
            try:
                self._serve(request)
            except Exception:  # noqa: BLE001 - one broken reply must not end the service
                _log.exception("a reply on %s could not be sent", self.key)
            del request

    def _next(self) -> Request | None:
        with self._changed:
            self._changed.wait_for(lambda: self._requests or self._is_closed)
            return None if self._is_closed else self._requests.popleft()

    def _serve(self, request: Request) -> None:
        try:
            payload = self._answer(request.payload)
        except TrigpointError as reason:
            request.refuse(str(reason))
        except Exception as reason:  # noqa: BLE001 - the asker must hear of it in any case
            _log.exception("the query on %s failed", self.key)
            request.refuse(f"the query failed ({type(reason).__name__}: {reason}); see the log")
        else:
            request.reply(payload)
