"""The service manager's watchdog: pinged only while the work itself goes on.

systemd gives a service of `Type=notify` a datagram socket, NOTIFY_SOCKET, on which it sends READY=1
and, if WatchdogSec is set, WATCHDOG=1 at least that often (sd_notify(3)). Without the socket
nothing is sent, but a hung thread still shows in the diagnostics.
"""

import logging
import os
import socket
import threading
from collections.abc import Mapping

from trigpoint.base.clock import Clock, SystemClock, to_ns

_log = logging.getLogger(__name__)

SOCKET = "NOTIFY_SOCKET"


class Pulse:
    """One thread's sign of life. A new one cannot be overdue before its first beat is due."""

    def __init__(self, name: str, within_s: float, clock: Clock) -> None:
        self.name = name
        self._within_s, self._clock = within_s, clock
        self.beat()

    def beat(self, within_s: float | None = None) -> None:
        """The thread is alive and will beat again within this time, by default the usual one."""
        usual_s = self._within_s
        self._due_ns = self._clock.elapsed_ns() + to_ns(usual_s if within_s is None else within_s)

    @property
    def is_overdue(self) -> bool:
        """Whether the thread should have beaten by now."""
        return self._clock.elapsed_ns() > self._due_ns


class Watchdog:
    """One per process; shared by its nodes, so that one camera's work cannot hide another's hang.

    Every method may be called from any thread.
    """

    def __init__(
        self, environment: Mapping[str, str] | None = None, clock: Clock | None = None
    ) -> None:
        self._address = (os.environ if environment is None else environment).get(SOCKET, "")
        self._clock = clock or SystemClock()
        self._lock = threading.Lock()
        self._pulses: list[Pulse] = []
        self._is_ready = False
        self._hung: tuple[str, ...] = ()

    def pulse(self, name: str, *, within_s: float) -> Pulse:
        """Watch one more thread, whose first beat is due within this time."""
        pulse = Pulse(name, within_s, self._clock)
        with self._lock:
            self._pulses.append(pulse)
        return pulse

    def forget(self, pulse: Pulse) -> None:
        """Stop watching a thread that has ended normally."""
        with self._lock:
            if pulse in self._pulses:
                self._pulses.remove(pulse)

    @property
    def hung(self) -> tuple[str, ...]:
        """The names of the threads that are overdue."""
        with self._lock:
            return tuple(pulse.name for pulse in self._pulses if pulse.is_overdue)

    def tick(self) -> None:
        """Tell the service manager that all is well, if it is; call it once a second."""
        hung = self.hung
        if hung != self._hung:
            self._hung = hung
            if hung:
                _log.error("no sign of life of: %s; the watchdog is not told", ", ".join(hung))
        if not hung:
            self._send("WATCHDOG=1" if self._is_ready else "READY=1\nWATCHDOG=1")
            self._is_ready = True

    def _send(self, text: str) -> None:
        if not self._address:
            return
        address = self._address
        if address.startswith("@"):  # the abstract namespace
            address = "\0" + address[1:]
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                sender.settimeout(1.0)
                sender.sendto(text.encode(), address)
        except OSError as reason:
            _log.warning("the service manager cannot be told (%s): %s", SOCKET, reason)
