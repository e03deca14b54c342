"""Ends a program that was told to stop: within two seconds, whatever hangs.

There is one `Ending` per process, as with signals, and they reach it on a thread of its own: so
nothing is raised into what the main thread does, where a callback of Python's own would swallow it,
and a call that hangs there holds nothing up. Code that waits during the end asks `left_s` how long
it may. Code that writes something irreplaceable does so inside `writing`, and gets more time on a
busy machine. Whatever does not close in time is left behind, and the process exits without it.
"""

import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

_log = logging.getLogger(__name__)

STOP_S = 2.0
"""From the signal to the end of the process."""
_WRITING_S = 8.0
"""How much longer writing a file may take: a lost network is worse than a late stop."""
LONGEST_END_S = STOP_S + _WRITING_S
"""After that a process has ended, or has ended itself by force."""
_LOOK_S = 0.02
_REQUESTS = (signal.SIGINT, signal.SIGTERM)


class Ending:
    """When this process was told to stop, and what is still being written. Any thread."""

    def __init__(self) -> None:
        self._since_s: float | None = None
        self._is_guarded = False
        self._stop: Callable[[], None] | None = None
        self._wakeup: int | None = None
        self._writers = 0
        self._left_behind: list[str] = []
        self._lock = threading.Lock()

    def guard(self) -> None:
        """From now on, end the process by force if a stop takes too long. Only for programs: it
        would end a test's process too."""
        self._is_guarded = True

    def listen(self) -> None:
        """From now on, SIGINT and SIGTERM request a stop; call it on the main thread."""
        if self._wakeup is not None:
            return
        reader, self._wakeup = os.pipe()
        os.set_blocking(self._wakeup, False)
        signal.set_wakeup_fd(self._wakeup, warn_on_full_buffer=False)
        for number in _REQUESTS:
            signal.signal(number, lambda *_: None)
        threading.Thread(target=self._hear, args=(reader,), name="stops", daemon=True).start()

    def _hear(self, reader: int) -> None:
        while numbers := os.read(reader, 64):
            if not set(_REQUESTS).isdisjoint(numbers):
                self.ask()
        os.close(reader)

    def tell(self, stop: Callable[[], None]) -> None:
        """Have `stop` called, on any thread, when a stop is requested; now if it already was."""
        with self._lock:
            self._stop = stop
        if self.is_asked:
            stop()

    def ask(self) -> None:
        """Request a stop. Only the first request counts. A program that has told nothing yet has
        nothing to close either, and ends at once."""
        with self._lock:
            if self.is_asked:
                return
            self._since_s, stop = time.monotonic(), self._stop
        if stop is not None:
            stop()
        elif self._is_guarded:
            self.leave(0)
        if self._is_guarded:
            self._watch()

    def forget(self) -> None:
        """Return to the state before any request to stop, and before any was listened for."""
        self._since_s = self._stop = None
        if self._wakeup is not None:
            signal.set_wakeup_fd(-1)
            os.close(self._wakeup)
            self._wakeup = None

    @property
    def is_asked(self) -> bool:
        """Whether a stop was requested."""
        return self._since_s is not None

    def left_s(self, reserve_s: float = 0.0) -> float:
        """How long something may take, with `reserve_s` kept for what follows; infinite if no stop
        was requested, and never negative."""
        if self._since_s is None:
            return math.inf
        return max(0.0, self._since_s + STOP_S - reserve_s - time.monotonic())

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Protects work that must not be cut short."""
        with self._lock:
            self._writers += 1
        try:
            yield
        finally:
            with self._lock:
                self._writers -= 1

    def leave_behind(self, what: str) -> None:
        """Note something that cannot be closed: the process will exit without it."""
        self._left_behind.append(what)
        _log.warning("%s did not close in time; it is left behind", what)

    def leave(self, status: int) -> NoReturn:
        """End the process; at once if a stop was requested or something was left behind, since a
        normal exit would wait for exactly that."""
        if not self.is_asked and not self._left_behind:
            sys.exit(status)
        _flush()
        os._exit(status)

    def _watch(self) -> None:
        time.sleep(STOP_S)
        until_s = time.monotonic() + _WRITING_S
        while self._writers and time.monotonic() < until_s:
            time.sleep(_LOOK_S)
        threads = [t.name for t in threading.enumerate() if t.is_alive() and not t.daemon]
        _log.error("not ended in %.0f s (%s); left by force", STOP_S, ", ".join(threads) or "—")
        _flush()
        os._exit(1)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()


ENDING = Ending()
"""The ending of this process."""
