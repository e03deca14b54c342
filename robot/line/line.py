"""A port with its protocol: reads, writes, and reopens the port after it was lost.

Two threads: the reader opens and closes the port and delivers events; the writer asks the protocol
what is due. Nothing queues up: a protocol holds at most one correction, the newest, which is
written by the thread that brings it.
"""

import logging
import threading
from collections.abc import Callable
from typing import Protocol as Interface

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.base.errors import PortError

from .protocol import Event, LocatedPose, Protocol, RobotCorrection, readable

_log = logging.getLogger(__name__)

FIRST_PAUSE_S = 0.1
# A port that is plugged in again is open within three seconds; udev takes up to one of them.
LONGEST_PAUSE_S = 1.0
# A port that never opens is probably misspelt; one that once opened will come back.
PATIENCE_S = 5.0
_LONGEST_WAIT_S = 0.25
# A line of text, or a frame or two.
_TAIL = 80


Beat = Callable[[], object]
"""Called by a thread from within its work, so that a hang is noticed."""


def _unwatched() -> None:
    """For a line without a watchdog."""


class OpenPort(Interface):
    """The port interface that the line needs; `Port` implements it."""

    def read(self) -> tuple[bytes, int]: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class Line:
    """`handle` is called with each event, on the reader's and the writer's thread; `failed` with
    the text of each port error. `patience_s`: how long the first opening may fail."""

    def __init__(
        self,
        open_port: Callable[[], OpenPort],
        protocol: Protocol,
        *,
        clock: Clock,
        handle: Callable[[Event], None],
        failed: Callable[[str], None],
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._patience_s = patience_s
        self._open_port, self._protocol, self._clock = open_port, protocol, clock
        self._handle, self._failed = handle, failed
        self._port: OpenPort | None = None
        # Guards the protocol; never held while reading, writing or handling events.
        self._changed = threading.Condition()
        # A port is not closed while the writer uses it: its descriptor might be reused by then.
        self._writing = threading.Lock()
        # When the writer next looks by itself: anything due earlier must wake it.
        self._wakes_ns = 0
        self._tail = b""
        self.opened = 0

    @property
    def is_open(self) -> bool:
        """Whether the port is open now."""
        return self._port is not None

    @property
    def last_line(self) -> str:
        """The last line that came, what is not printable escaped; "" if no byte came."""
        lines = self._tail.splitlines()
        return next((readable(line) for line in reversed(lines) if line.strip()), "")

    def correct(self, correction: RobotCorrection) -> None:
        """Send a correction now: handing it to the writer would take longer than writing it. Any
        thread but the reader's, since it blocks if the port takes no bytes (`WRITE_TIMEOUT_S`).
        """
        with self._changed:
            self._protocol.correct(correction)
        self._write_due()
        with self._changed:
            self._wake_writer()  # the writer repeats it if it is not answered

    def locate(self, pose: LocatedPose) -> None:
        """Send the robot its current pose. Any thread."""
        with self._changed:
            self._protocol.locate(pose)
            self._changed.notify()

    def read_until(self, stopping: threading.Event, beat: Beat = _unwatched) -> None:
        """The reader's thread: read, and reopen with growing pauses, until `stopping` is set.

        `beat` is called at every turn. Raises PortError if the port does not open at all within
        `patience_s`.
        """
        pause_s, last_trouble = FIRST_PAUSE_S, ""
        give_up_ns = self._clock.elapsed_ns() + to_ns(self._patience_s)
        while not stopping.is_set():
            beat()
            try:
                self._open()
                pause_s, last_trouble = FIRST_PAUSE_S, ""
                self._read(stopping, beat)
            except PortError as trouble:
                if not self.opened and self._clock.elapsed_ns() >= give_up_ns:
                    raise
                if str(trouble) != last_trouble:
                    last_trouble = str(trouble)
                    _log.warning("%s Trying again.", trouble)
                self._failed(str(trouble))
            finally:
                self._close()
            self._clock.wait(stopping, pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def write_until(self, stopping: threading.Event, beat: Beat = _unwatched) -> None:
        """The writer's thread: write what is due until `stopping` is set; `beat` as above."""
        while not stopping.is_set():
            beat()
            with self._changed:
                # One wait a turn: `wait_for` would go on with a time-out that is out of date when
                # what comes makes the next question due earlier.
                if not self._is_due():
                    self._changed.wait(self._wait_s())
                events = self._protocol.elapse(self._clock.elapsed_ns())
            self._give_out(events)
            self._write_due()

    def _wake_writer(self) -> None:
        """Wake the writer if something is due before it looks by itself."""
        if self._protocol.due_ns(self._clock.elapsed_ns()) < self._wakes_ns:
            self._changed.notify()

    def _is_due(self) -> bool:
        now_ns = self._clock.elapsed_ns()
        return self._port is not None and self._protocol.due_ns(now_ns) <= now_ns

    def _wait_s(self) -> float:
        now_ns = self._clock.elapsed_ns()
        due_s = to_seconds(self._protocol.due_ns(now_ns) - now_ns)
        wait_s = _LONGEST_WAIT_S if self._port is None else min(max(due_s, 0.0), _LONGEST_WAIT_S)
        self._wakes_ns = now_ns + to_ns(wait_s)
        return wait_s

    def _open(self) -> None:
        port = self._open_port()
        with self._changed:
            self._protocol.reset()
            self._port = port
            self.opened += 1
            self._changed.notify()

    def _read(self, stopping: threading.Event, beat: Beat) -> None:
        port = self._port
        assert port is not None
        while not stopping.is_set():
            beat()
            data, received_ns = port.read()
            if data:
                self._tail = (self._tail + data)[-_TAIL:]
                with self._changed:
                    events = self._protocol.receive(data, received_ns)
                    self._wake_writer()
                self._give_out(events)

    def _write_due(self) -> None:
        try:
            with self._writing:
                with self._changed:
                    port = self._port
                    if port is None:
                        return
                    data = self._protocol.data_to_send(self._clock.elapsed_ns())
                if data:
                    port.write(data)
        except PortError as trouble:
            # The reader notices a lost port by itself and reopens it.
            self._failed(str(trouble))

    def _give_out(self, events: list[Event]) -> None:
        for event in events:
            self._handle(event)

    def _close(self) -> None:
        with self._changed:
            port, self._port = self._port, None
        if port is not None:
            with self._writing:
                port.close()
