"""A node's health: counters, gauges and errors, and their form in the diagnostics."""

import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from enum import IntEnum

from msgspec import Struct

from trigpoint.base.clock import Clock, SystemClock, to_ns, to_seconds
from trigpoint.base.errors import MessageError
from trigpoint.base.words import loss_words
from trigpoint.bus.bus import Incoming, Sample
from trigpoint.contract.durations import Durations
from trigpoint.contract.messages import Mended

LOST_SO_FAR = "lost so far: "
"""How the message of a node begins that lost something lately."""
_MEMORY_NS = to_ns(10.0)
_MOST_SAID = 3


def mended_count(lack: Mended) -> str:
    """The counter of odometry messages that lacked something."""
    return f"odometry_{lack.name.lower()}"


class Level(IntEnum):
    """Levels of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Report(Struct, frozen=True):
    """One reading of a node's health; `values` in the form of the diagnostics.

    Keys: `NAME.total` and `NAME.rate` (per second) of a counter, `NAME.lost` of lost data,
    `NAME.depth` of a watched queue, `NAME.seconds` of a histogram (`contract.durations`), and
    `NAME` alone for a gauge or a state in words.
    """

    level: Level
    message: str
    values: dict[str, str]


class Health:
    """A node's counters, gauges and errors; every method may be called from any thread.

    `count` adds to a counter, shown as total and rate; `lose` does the same for lost data, which
    makes the status a warning; `observe` counts how long something took, as a
    histogram; `gauge` names a value that is read once a second (a queue's depth), `describe` a
    state in words; `fail` keeps the last error's text, which makes the status an error for a while;
    `hold` keeps an error until it is released.
    """

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or SystemClock()
        self._lock = threading.Lock()
        self._totals: Counter[str] = Counter()
        self._losses: Counter[str] = Counter()
        self._durations: defaultdict[str, Durations] = defaultdict(Durations)
        self._gauges: dict[str, Callable[[], float | None]] = {}
        self._watched: dict[str, Incoming] = {}
        self._descriptions: dict[str, str] = {}
        self._held: dict[str, str] = {}
        self._last_error = ""
        self._failed_ns: int | None = None
        self._lost_ns: int | None = None
        self._read_ns = self._clock.elapsed_ns()
        self._read_totals: dict[str, int] = {}
        self._read_losses: Counter[str] = Counter()

    def count(self, name: str, amount: int = 1) -> None:
        """Add to a counter."""
        with self._lock:
            self._totals[name] += amount

    def lose(self, name: str, amount: int = 1) -> None:
        """Count data that was lost."""
        with self._lock:
            self._losses[name] += amount

    def observe(self, name: str, seconds: float) -> None:
        """Count how long something took."""
        with self._lock:
            self._durations[name].add(seconds)

    def gauge(self, name: str, read: Callable[[], float | None]) -> None:
        """Show the result of `read`, which is called on the diagnostics thread; where that is None,
        the gauge is left out."""
        with self._lock:
            self._gauges[name] = read

    def describe(self, name: str, text: str) -> None:
        """Show a state in words, replacing its previous text."""
        with self._lock:
            self._descriptions[name] = text

    def watch(self, name: str, subscription: Incoming) -> None:
        """Show a subscription's total, rate, depth and losses."""
        with self._lock:
            self._watched[name] = subscription

    def fail(self, text: str) -> None:
        """Keep the last error's text."""
        with self._lock:
            self._last_error, self._failed_ns = text, self._clock.elapsed_ns()

    def hold(self, name: str, text: str) -> None:
        """Hold an error under a name until it is released; the text may change."""
        with self._lock:
            if name not in self._held:
                self._last_error = text
            self._held[name] = text

    def release(self, name: str) -> None:
        """Release the error held under this name, if any."""
        with self._lock:
            self._held.pop(name, None)

    def hold_only(self, group: str, troubles: Mapping[str, str]) -> None:
        """Hold these and release all others of the group."""
        with self._lock:
            kept = {n: t for n, t in self._held.items() if not n.startswith(f"{group}: ")}
            held = {f"{group}: {name}": text for name, text in troubles.items()}
            self._last_error = next(
                (text for name, text in held.items() if name not in self._held), self._last_error
            )
            self._held = kept | held

    @property
    def held(self) -> dict[str, str]:
        """The errors held now: name -> text."""
        with self._lock:
            return dict(self._held)

    def reject(self, sample: Sample, reason: MessageError) -> None:
        """Count a sample that does not decode as `rejected`, and name its sender."""
        sender = f"session {sample.sender}" if sample.sender else "an unknown session"
        self.count("rejected")
        self.fail(f"rejected a sample on {sample.key} from {sender}: {reason}")

    def total(self, name: str) -> int:
        """A counter's value, 0 if it was never counted."""
        with self._lock:
            return self._totals[name]

    def lost(self, name: str) -> int:
        """How much was counted as lost, 0 if nothing was."""
        with self._lock:
            return self._losses[name]

    @property
    def last_error(self) -> str:
        """The text of the last failure, "" if there was none."""
        return self._last_error

    def report(self) -> Report:
        """Read everything; rates are since the last report. Called by one thread."""
        now_ns = self._clock.elapsed_ns()
        with self._lock:
            totals, losses = dict(self._totals), Counter(self._losses)
            watched, gauges = dict(self._watched), dict(self._gauges)
            values = dict(self._descriptions)
            values |= {f"{name}.seconds": each.text for name, each in self._durations.items()}
        read_now = {name: read() for name, read in gauges.items()}
        values |= {name: _number(value) for name, value in read_now.items() if value is not None}
        for name, subscription in watched.items():
            totals[name] = totals.get(name, 0) + subscription.received
            losses[name] += subscription.dropped
            values[f"{name}.depth"] = str(subscription.depth)
        elapsed_s = max(to_seconds(now_ns - self._read_ns), 1e-3)
        for name, total in totals.items():
            values[f"{name}.total"] = str(total)
            rate = (total - self._read_totals.get(name, 0)) / elapsed_s
            values[f"{name}.rate"] = f"{rate:.1f}"
        values |= {f"{name}.lost": str(loss) for name, loss in losses.items()}
        values["last_error"] = self._last_error
        level, message = self._judge(losses, now_ns)
        self._read_ns, self._read_totals, self._read_losses = now_ns, totals, losses
        return Report(level, message, dict(sorted(values.items())))

    def _judge(self, losses: Counter[str], now_ns: int) -> tuple[Level, str]:
        if losses != self._read_losses and any(losses.values()):
            self._lost_ns = now_ns
        if held := list(self.held.values()):
            return Level.ERROR, "; ".join(held[:_MOST_SAID]) + _and_more(len(held) - _MOST_SAID)
        if self._failed_ns is not None and now_ns - self._failed_ns < _MEMORY_NS:
            return Level.ERROR, self._last_error
        if self._lost_ns is not None and now_ns - self._lost_ns < _MEMORY_NS:
            return Level.WARN, f"{LOST_SO_FAR}{loss_words(losses)}"
        return Level.OK, "running"


def _and_more(count: int) -> str:
    return f"; and {count} more" if count > 0 else ""


def _number(value: float) -> str:
    return f"{value:.6g}"
