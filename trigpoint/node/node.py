"""A node's life: liveliness token, diagnostics once a second, orderly stop.

A command looks like this:

    node = Node(bus, site=site.name, kind="edge", name=camera)
    with stopped_by_signals(node):
        ...node.thread("detect", run) for threads that watch node.stopping...
        node.wait()   # until SIGINT, SIGTERM, node.stop() or an error in one of the threads
"""

import logging
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import TracebackType
from typing import Protocol, Self, TypeVar

from trigpoint import CONTRACT, __version__
from trigpoint.base.clock import NANOSECONDS, SETTLED_NS, Clock, SteadyClock, to_seconds
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import BusError, MessageError, OperationError
from trigpoint.bus.bus import Bus, Closable, Publisher, Subscription
from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.clock_doubt import CLOCK_SET_BY
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.contract.topics import DIAGNOSTICS, alive_key

from .health import LOST_SO_FAR, Health, Level, Report
from .peers import MET, Peers
from .watchdog import Pulse, Watchdog

__all__ = ["Health", "Node", "stop_on_signals", "stopped_by_signals"]

_log = logging.getLogger(__name__)

STOP_S = 2.0
# The part of a stop's time kept for what follows the threads: last diagnostics, files.
_REST_S = 1.3
_LEAST_JOIN_S = 0.1
_TAKEOVER_S, _ASKING_S = 2.0, 1.0
_NEWCOMER_S = 5.0
_PULSE_S = 10.0
_MOST_HEARD = 256
"""How many of the other nodes' diagnostics are read in one go."""
# One turn of work takes far less, even on a small, busy machine.
_WORK_S = 20.0

_Declared = TypeVar("_Declared", bound=Closable)


class Node:
    """One node on the bus. Several may share a bus and a process (an agent with two cameras).

    Nodes in one process may share `stopping`, so that all stop when one does, and must share
    `watchdog`, with which they register their threads.
    """

    health: Health
    stopping: threading.Event
    watchdog: Watchdog

    def __init__(
        self,
        bus: Bus,
        *,
        site: str,
        kind: str,
        name: str,
        clock: Clock | None = None,
        stopping: threading.Event | None = None,
        watchdog: Watchdog | None = None,
        period_s: float = 1.0,
    ) -> None:
        self.clock = self._clock = clock or SteadyClock()
        self.health = Health(self._clock)
        self.stopping = stopping or threading.Event()
        self.watchdog = watchdog or Watchdog(clock=self._clock)
        self.label = f"{kind}/{name}"
        self._bus, self._site, self._period_s = bus, site, period_s
        self._token_key = alive_key(site, kind, name)
        self._unique = uuid.uuid4().hex
        self._started_ns = self._clock.elapsed_ns()
        self._born_ns = self._clock.now_ns()
        self._peers = Peers(self.label, self._unique, self._born_ns)
        self._publisher: Publisher | None = None
        self._declared: list[Closable] = []
        self._threads: list[threading.Thread] = []
        self._error: BaseException | None = None
        self._logged_error = ""
        self._logged_held: dict[str, str] = {}
        self._connection = ""
        self._reported: Diagnostics | None = None

    def __enter__(self) -> Self:
        self._refuse_second()
        try:
            self._begin()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()
        if error is None:
            self._raise_error()

    def _begin(self) -> None:
        key = DIAGNOSTICS.key(self._site)
        publisher = self._publisher = self._bus.publisher(DIAGNOSTICS, key)
        others = self._bus.subscribe(DIAGNOSTICS, key)
        self._declared = [publisher, others]
        encode(self.diagnostics())  # loads the types now; a stop has no time to
        self.thread("diagnostics", lambda: self._report(publisher, others))
        self._declared.append(self._bus.declare_alive(self._token_key))
        _log.info("%s runs on site %s (session %s)", self.label, self._site, self._bus.identity)

    def _end(self) -> None:
        self.stop()
        self._join()
        self._say_last()
        while self._declared:
            self._declared.pop().close()
        _log.info("%s stopped", self.label)

    def _say_last(self) -> None:
        """Send the last diagnostics, with the final counts."""
        try:
            if self._publisher is not None:
                self._publisher.put(encode(self.diagnostics()))
        except BusError as reason:
            _log.warning("%s: the last diagnostics were not sent: %s", self.label, reason)

    def thread(self, name: str, run: Callable[[], object]) -> None:
        """Start a thread that is joined when the node ends; an error in it stops the node.

        `run` must return within a second of `stopping` being set.
        """
        title = f"{self.label} {name}"
        thread = threading.Thread(target=self._guard, args=(run,), name=title, daemon=True)
        self._threads.append(thread)
        thread.start()

    def work(self, name: str, run: Callable[[Pulse], object], *, within_s: float = _WORK_S) -> None:
        """Like `thread`, but supervised by the watchdog: `run` must beat its pulse at least every
        `within_s`; a thread that hangs is named in the diagnostics."""
        pulse = self.watchdog.pulse(f"{self.label} {name}", within_s=within_s)

        def watched() -> None:
            try:
                run(pulse)
            finally:
                self.watchdog.forget(pulse)

        self.thread(name, watched)

    def keep(self, declared: _Declared) -> _Declared:
        """Withdraw this declaration at the node's end, behind its threads; returns it."""
        self._declared.append(declared)
        return declared

    def stop(self) -> None:
        """Ask the node to end."""
        self.stopping.set()

    def wait(self) -> None:
        """Return when the node is asked to end; raise the error that ended one of its threads."""
        self.stopping.wait()
        self._raise_error()

    def _guard(self, run: Callable[[], object]) -> None:
        try:
            run()
        except BaseException as error:  # noqa: BLE001 - handed to `wait`, which raises it
            self._error = self._error or error
            self.stop()

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _join(self) -> None:
        within_s = max(_LEAST_JOIN_S, min(STOP_S, ENDING.left_s(_REST_S)))
        deadline = time.monotonic() + within_s
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
            if thread.is_alive():
                _log.error("thread «%s» did not stop in %.1f s", thread.name, within_s)

    def _refuse_second(self) -> None:
        """Raise OperationError if the identity is taken; a killed node's token expires by then."""
        deadline = time.monotonic() + _TAKEOVER_S
        while self._bus.alive(self._token_key, timeout_s=_ASKING_S):
            if self.stopping.wait(0.2) or time.monotonic() > deadline:
                raise OperationError(self._second)

    @property
    def _second(self) -> str:
        return (
            f"{self.label} already runs on site {self._site}; "
            "stop that one first, or give this one another name"
        )

    def _report(self, publisher: Publisher, others: Subscription) -> None:
        due = time.monotonic()
        pulse = self.watchdog.pulse(f"{self.label} diagnostics", within_s=_PULSE_S)
        while not self.stopping.is_set():
            pulse.beat(self._period_s + _PULSE_S)
            self.watchdog.tick()
            self._look_at_clock()
            self._listen(others)
            publisher.put(encode(self.diagnostics()))
            due = max(due + self._period_s, time.monotonic())
            self.stopping.wait(due - time.monotonic())
        self.watchdog.forget(pulse)

    def _look_at_clock(self) -> None:
        """Check whether this machine's clock was set; stamps carry on until it is trusted."""
        if not isinstance(self._clock, SteadyClock):
            return
        followed, set_by_ns = self._clock.followed, self._clock.look()
        if self._clock.followed != followed:
            _log.warning("%s: this machine's clock is followed now; stamps jump", self.label)
        if not set_by_ns:
            self.health.release("clock")
            return
        self.health.hold(
            "clock",
            f"this machine's clock was set by {to_seconds(set_by_ns):+.3f} s; stamps go on as "
            f"before, and follow it once it has stood for {to_seconds(SETTLED_NS):.0f} s",
        )

    @property
    def clock_set_by_ns(self) -> int:
        """By how much this machine's clock was set, while not yet followed; 0 if all is well."""
        return self._clock.set_by_ns if isinstance(self._clock, SteadyClock) else 0

    def silent_s(self, server: str) -> float | None:
        """How long nothing has been heard of `fusion` or `recorder`; None if it never was."""
        return self._peers.silent_s(server)

    def trouble_of(self, server: str) -> str:
        """What `fusion` or `recorder` says is wrong with it, "" where nothing is."""
        return self._peers.trouble_of(server)

    def diagnostics(self) -> Diagnostics:
        """The node's current diagnostics. Called on the diagnostics thread."""
        if (more := self._bus.unsent - self.health.lost("unsent")) > 0:
            self.health.lose("unsent", more)
        report = self.health.report()
        held = self.health.held
        if self.health.last_error not in ("", self._logged_error):
            self._logged_error = self.health.last_error
            if self._logged_error not in held.values():
                _log.error("%s: %s", self.label, self._logged_error)
        self._log_held(held)
        level, message = self._judge(report)
        values = (
            self._identity()
            | self._clock_values()
            | self._certificate_values()
            | {"peers": str(len(self._bus.peers)), MET: self._peers.met}
            | report.values
        )
        status = DiagnosticStatus(int(level), self.label, message, socket.gethostname(), values)
        self._reported = Diagnostics(self._clock.now_ns(), (status,))
        return self._reported

    @property
    def reported(self) -> Diagnostics | None:
        """The diagnostics that were read last, None before the first. Any thread."""
        return self._reported

    def _log_held(self, held: dict[str, str]) -> None:
        """Log problems that have begun, and those that are over."""
        for name in held.keys() - self._logged_held.keys():
            _log.error("%s: %s", self.label, held[name])
        for name in self._logged_held.keys() - held.keys():
            _log.info("%s: over: %s", self.label, self._logged_held[name])
        self._logged_held = held

    def _judge(self, report: Report) -> tuple[Level, str]:
        """Everything that is wrong, the worst first: none hides another. What was lost is said only
        where nothing else is: the values have it, and its coming and going is no other complaint.
        """
        hung = ", ".join(self.watchdog.hung)
        outside = (hung and f"no sign of life of: {hung}", self._peers.complaint())
        found = [(Level.ERROR, text) for text in (*outside, self._connection_complaint())]
        found += [(Level.WARN, self._bus.warning), (report.level, report.message)]
        said = [(level, text) for level, text in found if level is not Level.OK and text]
        said = [one for one in said if not one[1].startswith(LOST_SO_FAR)]
        if not said:
            return report.level, report.message
        return max(said)[0], "; ".join(text for _, text in sorted(said, key=lambda one: -one[0]))

    def _connection_complaint(self) -> str:
        """What is wrong with the connection to the other nodes; changes are logged."""
        names = ", ".join(self._bus.unreached)
        complaint = f"nobody answers at {names} (bus.connect); trying again" if names else ""
        if complaint != self._connection:
            self._connection = complaint
            _log.warning("%s: %s", self.label, complaint or "connected again")
        return complaint

    def _clock_values(self) -> dict[str, str]:
        set_by_ns = self.clock_set_by_ns
        return {CLOCK_SET_BY: f"{to_seconds(set_by_ns):+.3f}"} if set_by_ns else {}

    def _certificate_values(self) -> dict[str, str]:
        days = self._bus.certificate_days
        return {} if days is None else {"certificate_days": f"{days:.1f}"}

    def _identity(self) -> dict[str, str]:
        return {
            "version": __version__,
            "contract": str(CONTRACT),
            "session": self._bus.identity,
            "node": self._unique,
            "process": str(os.getpid()),
            "started": str(self._born_ns),
            "uptime": f"{self._uptime_s:.1f}",
        }

    @property
    def _uptime_s(self) -> float:
        return (self._clock.elapsed_ns() - self._started_ns) / NANOSECONDS

    def _listen(self, others: Subscription) -> None:
        """Read the other nodes' diagnostics."""
        for _ in range(_MOST_HEARD):
            sample = others.take(0.0)
            if sample is None:
                return
            try:
                message = _heard(sample.payload)
            except MessageError as reason:
                self.health.reject(sample, reason)
                continue
            for status in message.statuses:
                self._meet(status)

    def _meet(self, status: DiagnosticStatus) -> None:
        is_elder = self._peers.meet(status)
        if is_elder and self._uptime_s < _NEWCOMER_S:
            raise OperationError(self._second)


@lru_cache(64)
def _heard(payload: bytes) -> Diagnostics:
    """A node's diagnostics, not to be written to: all nodes of a process, as an agent's cameras,
    hear the same. Raises MessageError."""
    message = decode(DIAGNOSTICS.type_name, payload)
    assert isinstance(message, Diagnostics)
    return message


def stopped_by_signals(node: Node) -> Node:
    """Have SIGINT and SIGTERM stop the node, and return it. Installed before the node starts, as a
    signal during the start would leave it half started. Call it on the main thread."""
    stop_on_signals([node])
    return node


class Stoppable(Protocol):
    """Anything that runs until it is asked to end, such as a node."""

    def stop(self) -> None: ...


def stop_on_signals(nodes: Sequence[Stoppable]) -> None:
    """Have SIGINT and SIGTERM stop these nodes; call it on the main thread.

    If a signal came earlier, they stop now. Further signals change nothing: a stop ends by itself
    (`ending`), and Ctrl-C often comes with a SIGTERM from the parent process.
    """

    def stop() -> None:
        for node in nodes:
            node.stop()

    ENDING.listen()
    ENDING.tell(stop)
