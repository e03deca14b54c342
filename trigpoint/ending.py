"""Ends a program that was told to stop: within two seconds, whatever hangs.

There is one `Ending` per process, as with signals. Code that waits during the end asks `left_s` how
long it may. Code that writes something irreplaceable does so inside `writing`, and gets more time
on a busy machine. Whatever does not close in time is left behind, and the process exits without it.
"""

import _thread
import logging
import math
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

_log = logging.getLogger(__name__)

STOP_S = 2.0
"""From the signal to the end of the process."""
_WRITING_S = 8.0
"""How much longer writing a file may take: a lost network is worse than a late stop."""
_LOOK_S = 0.02


class Ending:
    """When this process was told to stop, and what is still being written. Any thread."""

    def __init__(self) -> None:
        self._since_s: float | None = None
        self._is_guarded = False
        self._is_asked = False
        self._writers = 0
        self._left_behind: list[str] = []
        self._lock = threading.Lock()

    def guard(self) -> None:
        """From now on, end the process by force if a stop takes too long. Only for programs: it
        would end a test's process too."""
        self._is_guarded = True

    def ask(self) -> bool:
        """Note that a stop was requested; return whether it is the first request. Takes no lock, so
        a signal handler may call it."""
        if self._is_asked:
            return False
        self._is_asked, self._since_s = True, time.monotonic()
        if self._is_guarded:
            # No threading.Thread: starting one takes locks that the interrupted thread may hold.
            _thread.start_new_thread(self._watch, ())
        return True

    def forget(self) -> None:
        """Return to the state before any request to stop."""
        self._is_asked, self._since_s = False, None

    @property
    def is_asked(self) -> bool:
        """Whether a stop was requested."""
        return self._is_asked

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
        if not self._is_asked and not self._left_behind:
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
