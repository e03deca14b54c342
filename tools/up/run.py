"""Runs the parts until a stop is asked, or one of them does not stay alive."""

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

from trigpoint.base.ending import LONGEST_END_S
from trigpoint.base.errors import OperationError
from trigpoint.base.words import counted
from trigpoint.tools.parts.joined_log import JoinedLog
from trigpoint.tools.parts.specs import leashed
from trigpoint.tools.parts.supervisor import PartSpec, Supervisor

_NAME = "up"
_LOOK_S = 0.1
STOP_S = LONGEST_END_S + 1.0
"""A part ends within two seconds; one that still writes a network or a recording is let finish."""
_WIDEST_NAME = 24
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stop:
    """Whether a stop was asked. A second request raises KeyboardInterrupt: somebody is in a
    hurry, and what still runs is killed."""

    def __init__(self) -> None:
        self.is_asked = False

    def ask(self, _number: int, _frame: FrameType | None) -> None:
        if self.is_asked:
            raise KeyboardInterrupt
        self.is_asked = True


def run_parts(specs: Sequence[PartSpec], stream: TextIO) -> None:
    """Start the parts, join what they say, start again what ends, and stop them in order.

    Returns once a stop was asked (SIGINT, SIGTERM, SIGHUP) and all have ended. Raises
    OperationError where a part does not stay alive or nobody takes the log any more, InputError
    where a part refused its files; all have ended then too. Call it on the main thread.
    """
    width = min(_WIDEST_NAME, max(len(spec.name) for spec in specs))
    with JoinedLog(stream, width=width) as log, _asked() as stop:

        def say(line: str) -> None:
            log.say(_NAME, line)

        supervisor = Supervisor(
            [leashed(spec) for spec in specs], log.output, say=say, stop_s=STOP_S
        )
        with supervisor:
            say(f"{counted(len(specs), 'part')} started; Ctrl-C stops all")
            _watch(supervisor, log, stop)
            say("stopping, in order")
        log.drain()
        say("all parts have ended")


def _watch(supervisor: Supervisor, log: JoinedLog, stop: Stop) -> None:
    """Return when a stop is asked."""
    while not stop.is_asked:
        supervisor.revive()
        if log.is_broken:
            raise OperationError("nobody takes the log any more; all parts are stopped")
        time.sleep(_LOOK_S)


@contextmanager
def _asked() -> Iterator[Stop]:
    """Signals ask for a stop inside the `with` block; one that was ignored (nohup) stays so."""
    stop, before = Stop(), {number: signal.getsignal(number) for number in _SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, stop.ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
