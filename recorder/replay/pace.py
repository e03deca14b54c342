"""The pace of a replay: the recorded one times a rate, held and stepped by whoever watches."""

import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from msgspec import Struct

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.recorder.session.recording import LAST_NS

_LOOK_S = 0.1


class Span(Struct, frozen=True):
    """Which log times are replayed, both ends included, and whether again and again."""

    from_ns: int = 0
    to_ns: int = LAST_NS
    loops: bool = False


WHOLE = Span()


class Controls:
    """Holds a replay, and lets single messages through. Any thread."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._is_paused = False
        self._steps = 0

    @property
    def is_paused(self) -> bool:
        return self._is_paused

    def pause(self) -> None:
        """Hold, or go on."""
        with self._changed:
            self._is_paused = not self._is_paused
            self._steps = 0
            self._changed.notify_all()

    def step(self) -> None:
        """Hold, and let one more message through."""
        with self._changed:
            self._is_paused = True
            self._steps += 1
            self._changed.notify_all()

    def wait(self, stopping: threading.Event) -> bool:
        """Wait while it is held; whether it was."""
        if not self._is_paused:
            return False
        with self._changed:
            while self._is_paused and not self._steps and not stopping.is_set():
                self._changed.wait(_LOOK_S)
            self._steps = max(0, self._steps - 1)
        return True


class Pace:
    """Waits until a log time is due; the first one is due at once."""

    def __init__(
        self, rate: float, clock: Clock, stopping: threading.Event, controls: Controls
    ) -> None:
        self._rate, self._clock, self._stopping = rate, clock, stopping
        self._controls = controls
        self._first_ns: int | None = None
        self._started_ns = clock.elapsed_ns()

    def is_due(self, log_ns: int) -> bool:
        """Wait; False where the replay is to stop."""
        if self._first_ns is None:
            self._first_ns = log_ns
        while (ahead_ns := self._ahead_ns(log_ns)) > 0 and not self._controls.is_paused:
            if self._clock.wait(self._stopping, min(to_seconds(ahead_ns), _LOOK_S)):
                return False
        if self._controls.wait(self._stopping):
            # What was held goes on from here at the pace.
            due_ns = round((log_ns - self._first_ns) / self._rate)
            self._started_ns = self._clock.elapsed_ns() - due_ns
        return not self._stopping.is_set()

    def _ahead_ns(self, log_ns: int) -> int:
        assert self._first_ns is not None
        due_ns = round((log_ns - self._first_ns) / self._rate)
        return due_ns - (self._clock.elapsed_ns() - self._started_ns)


def span_of(start_ns: int, from_s: float, to_s: float, *, loops: bool) -> Span:
    """Seconds from a recording's start as log times; `to_s` of 0: to its end."""
    until_ns = start_ns + to_ns(to_s) if to_s else LAST_NS
    return Span(start_ns + to_ns(from_s) if from_s else 0, until_ns, loops)


@contextmanager
def keyboard(controls: Controls, stop: Callable[[], None]) -> Iterator[bool]:
    """Space holds and goes on, «s» steps, «q» ends; yields whether there is a keyboard."""
    if not sys.stdin.isatty():
        yield False
        return
    before = termios.tcgetattr(sys.stdin)
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            if select.select([sys.stdin], [], [], _LOOK_S)[0]:
                key = sys.stdin.read(1)
                if key == " ":
                    controls.pause()
                elif key in "s.":
                    controls.step()
                elif key == "q":
                    stop()

    thread = threading.Thread(target=read, name="keyboard", daemon=True)
    try:
        tty.setcbreak(sys.stdin)
        thread.start()
        yield True
    finally:
        ended.set()
        thread.join()
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
