"""A process of its own that solves for the live estimator, so that no correction waits for it.

A thread would not do: it holds the interpreter between its many small numpy calls, and a filter's
step needs the interpreter as often. Orders and news go through a pipe each; a thread at either end
ensures that neither side ever waits for the other.
"""

import logging
import math
import os
import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection

from msgspec import Struct

from trigpoint.base.errors import OperationError
from trigpoint.contract import topics
from trigpoint.contract.messages import OccupancyGrid, PoseStamped
from trigpoint.fusion.coverage.announced import AnnouncedMap
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.guidance.suggestions import suggestions
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.output import Output
from trigpoint.fusion.solver.snapshot import GuidanceWorld
from trigpoint.geometry import Pose
from trigpoint.node.watchdog import Pulse

from .coverage_thread import cover
from .memory import return_large_arrays
from .solver_messages import News, Order, Reported, Solved
from .solver_worker import SolverWorker

START_S = 60.0
"""How long the process may take to begin, also on a small machine that is busy."""
_GUIDANCE_PERIOD_S = 3.0
_COVER_NICENESS = 10
_JOIN_S = 1.0
_SIGN_PERIOD_S = 1.0
# For one order: a long session takes a minute to solve, and none ten times the longest so far.
_PATIENCE_S = 300.0
_TIMES_THE_LONGEST = 10.0

_log = logging.getLogger(__name__)


class Alive(Struct, frozen=True):
    """A sign of life of the thread that solves; the next one comes within this time."""

    within_s: float


class Took(Struct, frozen=True):
    """How long it took to solve everything anew."""

    seconds: float


class SolverProcess:
    """See `Solver`. `data`: empty but for what is known beforehand; not used by anyone else.
    `pulse` is beaten by the work in the process; `forget`: called with it when that is to end;
    `took`: called with how long each solution took, s, on a thread of this."""

    def __init__(
        self,
        data: DataSet,
        pulse: Pulse | None = None,
        forget: Callable[[Pulse], None] = lambda _: None,
        took: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._pulse, self._forget, self._took = pulse, forget, took
        self._beat(START_S)
        context = get_context("spawn")
        theirs, self._orders = context.Pipe(duplex=False)
        self._news, theirs_too = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_serve, args=(theirs, theirs_too), name="fusion solver", daemon=True
        )
        # The node handles a stop, and may want a last solution. A Ctrl-C, or a service manager's
        # SIGTERM to all, reaches this process too, even before it could ignore the signal; instead,
        # it ends when its pipe does. The tracker that `start` would start unblocks both
        # signals (Python 3.11), so it is started before.
        resource_tracker.ensure_running()
        with _held_back(signal.SIGINT, signal.SIGTERM):
            self._process.start()
        theirs.close()
        theirs_too.close()
        self._outbox: queue.SimpleQueue[DataSet | Sequence[Order] | None] = queue.SimpleQueue()
        # Not as an argument: if it is larger than the pipe's buffer, we would block until the
        # process reads it, and for ever if it is killed before.
        self._outbox.put(data)
        self._inbox: queue.SimpleQueue[News] = queue.SimpleQueue()
        self._is_gone = threading.Event()
        self._threads = [
            threading.Thread(target=run, name=f"fusion solver {run.__name__}", daemon=True)
            for run in (self._send, self._receive)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """The process's id."""
        assert self._process.pid is not None  # it was started
        return self._process.pid

    def tell(self, orders: Sequence[Order]) -> None:
        """Hand orders over; never waits."""
        self._outbox.put(tuple(orders))

    def news(self) -> list[News]:
        """The news since the last call; raise OperationError where the process has died."""
        found = []
        while not self._inbox.empty():
            found.append(self._inbox.get())
        if self._is_gone.is_set() and not found:
            self._process.join(_JOIN_S)
            raise OperationError(
                f"the process that solves for fusion ended (status {self._process.exitcode}); "
                "start fusion again, it resumes its map"
            )
        return found

    def close(self) -> None:
        """End the process, whatever it is doing."""
        if self._pulse is not None:
            self._forget(self._pulse)
        self._process.kill()
        self._outbox.put(None)
        for thread in self._threads:
            thread.join(_JOIN_S)
        self._process.join(_JOIN_S)
        self._orders.close()
        self._news.close()

    def _send(self) -> None:
        while (item := self._outbox.get()) is not None:
            try:
                self._orders.send(item)
            except OSError:
                return  # it died, which `_receive` sees too

    def _receive(self) -> None:
        try:
            while True:
                item = pickle.loads(self._news.recv_bytes())
                if isinstance(item, Alive):
                    self._beat(item.within_s)
                elif isinstance(item, Took):
                    self._took(item.seconds)
                else:
                    self._inbox.put(item)
        except (EOFError, OSError):
            self._is_gone.set()

    def _beat(self, within_s: float) -> None:
        if self._pulse is not None:
            self._pulse.beat(within_s)


@contextmanager
def _held_back(*signals: signal.Signals) -> Iterator[None]:
    """Block these signals for the calling thread and for processes that it starts."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# -- in the process -------------------------------------------------------------------------------


def _serve(orders: Connection, news: Connection) -> None:
    """Take the data set and carry out orders, until the pipe ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    return_large_arrays()
    try:
        data: DataSet = orders.recv()
    except (EOFError, OSError):
        return  # the live estimator is gone
    backlog: queue.SimpleQueue[Order] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(orders, backlog), daemon=True).start()
    worker, lock = SolverWorker(data), threading.Lock()
    saying = threading.Lock()

    def say(item: News | Alive | Took) -> None:
        with saying:
            news.send_bytes(pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL))

    def world() -> GuidanceWorld | None:
        with lock:
            return worker.guidance_world()

    threading.Thread(target=_guide, args=(world, say), daemon=True).start()
    newest: queue.Queue[Results] = queue.Queue(maxsize=1)
    announced = AnnouncedMap(data.site, data.targets)
    threading.Thread(target=_cover, args=(announced, newest, say), daemon=True).start()
    sign = Heartbeat(say, time.monotonic)
    while True:
        try:
            order = backlog.get(timeout=_SIGN_PERIOD_S)
        except queue.Empty:
            order = None
        sign.give()
        began_s = time.monotonic()
        with lock:
            for item in worker.carry_out(order) if order is not None else ():
                _say_solved(item, began_s, say)
            # While more orders wait, what they bring is to be explained with the rest.
            for item in worker.rest() if backlog.empty() else ():
                _say_solved(item, began_s, say)
                if isinstance(item, Reported):
                    with suppress(queue.Empty):  # in place of those that wait still
                        newest.get_nowait()
                    newest.put_nowait(item.results)


def _say_solved(item: News, began_s: float, say: Callable[[News | Took], None]) -> None:
    """Say what an order brought, and of a solution how long it took."""
    if isinstance(item, Solved):
        say(Took(time.monotonic() - began_s))
    say(item)


def _listen(orders: Connection, backlog: "queue.SimpleQueue[Order]") -> None:
    try:
        while True:
            for order in orders.recv():
                backlog.put(order)
    except (EOFError, OSError):
        os._exit(0)  # the live estimator is gone: nobody needs what is being solved


class Heartbeat:
    """Reports that the work goes on, at most once a second. The time limit that it announces grows
    with the longest time between two calls, since solutions take longer as a session grows."""

    def __init__(self, say: Callable[[Alive], None], seconds: Callable[[], float]) -> None:
        self._say, self._seconds = say, seconds
        self._called_s, self._said_s, self._longest_s = seconds(), -math.inf, 0.0

    def give(self) -> None:
        now_s = self._seconds()
        self._longest_s = max(self._longest_s, now_s - self._called_s)
        self._called_s = now_s
        if now_s - self._said_s >= _SIGN_PERIOD_S:
            self._said_s = now_s
            self._say(Alive(max(_PATIENCE_S, _TIMES_THE_LONGEST * self._longest_s)))


def _cover(
    announced: AnnouncedMap, newest: "queue.Queue[Results]", say: Callable[[News], None]
) -> None:
    """Say how well a robot is corrected where, after each of the newest results."""
    # Of this thread alone: on Linux priorities are threads' own.
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _COVER_NICENESS)

    def say_grid(grid: OccupancyGrid) -> None:
        say(Output(topics.COVERAGE_GRID, "", grid))

    cover(announced, newest.get, say_grid, wait=time.sleep)


def _guide(world: Callable[[], GuidanceWorld | None], say: Callable[[News], None]) -> None:
    """Suggest every few seconds where each robot should go next."""
    guide = Guide()
    while True:
        time.sleep(_GUIDANCE_PERIOD_S)
        known = world()
        for found in guide.suggested(known) if known is not None else ():
            say(found)


class Guide:
    """Suggests where each robot should go next; worked out again only where that may be another
    place. Not thread-safe."""

    def __init__(self) -> None:
        self._before: GuidanceWorld | None = None
        self._next: dict[str, Pose] = {}

    def suggested(self, known: GuidanceWorld) -> Iterator[Output]:
        """Where each robot should go next by what is known now."""
        if self._before is None or not known.is_as(self._before):
            found = (each for robot in known.robots for each in suggestions(known, robot))
            self._next = {each.robot: each.map_from_base for each in found}
            self._before = known
        for robot, map_from_base in self._next.items():
            message = PoseStamped(known.robots[robot].stamp_ns, "map", map_from_base)
            yield Output(topics.SUGGESTION, robot, message)
