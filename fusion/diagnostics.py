"""What is wrong with the input, as text for the diagnostics, for as long as it lasts.

Pure: no bus, no clock.
"""

from collections import Counter
from collections.abc import Iterator

from msgspec import Struct

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.contract import topics
from trigpoint.node.health import Health
from trigpoint.site.config import Site

from .intake.admission import Admission
from .intake.arrivals import Span
from .pipeline import Pipeline

_STALE_NS = to_ns(3.0)
"""For how long odometry must be old, or missing, until that is reported."""
_LEAST_SEEN = 8
"""So many pictures before odometry begins are nothing unusual: a camera may be there first."""
_TOLD_NS = to_ns(5.0)
"""For how long a problem is reported after the last message that was left out for it."""
_BACKLOG = "late "
"""The problem that what waited for odometry, for a link or for this program's start has too: it is
told only where it lasts, or comes again, since then nothing comes in time."""
_AGAIN_NS = to_ns(300.0)
"""For how long that it came is remembered: a robot may pass a camera now and then, for seconds."""


class _Told(Struct):
    """A problem's count when it was looked at, and since when, and until when, it grew."""

    count: int
    since_ns: int
    grown_ns: int


class Diagnostics:
    """The diagnostics of one site's input. Not thread-safe. Times are monotonic, ns."""

    def __init__(self, site: Site, admission: Admission) -> None:
        self._site, self._admission = site, admission
        self._reported: Counter[str] = Counter()
        self._told: dict[str, _Told] = {}
        self._stale_since_ns: dict[str, int] = {}
        self._heard_ns: dict[str, int] = {}
        self._seen: dict[str, tuple[Span, int]] = {}
        self._problem = ""

    def heard(self, key: str, now_ns: int) -> None:
        """Note that a message of a key was accepted."""
        self._heard_ns[key] = now_ns

    def restart(self) -> None:
        """Note that the pipeline is a new one, whose counts start at zero."""
        self._reported.clear()
        self._reported.update(self._admission.counts)
        own = self._admission.problems  # which go on
        self._told = {name: told for name, told in self._told.items() if name in own}
        self._stale_since_ns.clear()
        self._seen.clear()

    def report(self, pipeline: Pipeline, health: Health, now_ns: int, *, checkpoint: str) -> None:
        """Put what was left out, and what is wrong or went wrong, into a node's health;
        `checkpoint`: why the map is not stored, "" where it is."""
        for reason, more in self.left_out(pipeline):
            health.count(f"left_out.{reason}", more)
        troubles = self.now(pipeline, now_ns)
        if checkpoint:
            troubles["checkpoint"] = checkpoint
        health.hold_only("input", troubles)
        problem = pipeline.last_problem
        if problem != self._problem:
            self._problem = problem
            if problem and all(problem != known.text for known in pipeline.problems.values()):
                health.fail(problem)

    def left_out(self, pipeline: Pipeline) -> Iterator[tuple[str, int]]:
        """(reason, how many more were left out since the last call)."""
        for reason, count in (Counter(pipeline.left_out) + self._admission.counts).items():
            more = count - self._reported[reason]
            if more > 0:  # what is cleared up later was left out all the same
                self._reported[reason] = count
                yield reason, more

    def now(self, pipeline: Pipeline, now_ns: int) -> dict[str, str]:
        """Name -> what is wrong now."""
        found = dict(self._admission.troubles(now_ns))
        for name, problem in (self._admission.problems | pipeline.problems).items():
            if self._is_now(name, problem.count, now_ns):
                found[name] = problem.text
        if pipeline.is_clock_set:
            found["clock"] = "no corrections: this machine's clock was set and is not followed yet"
        for part in (self._doubted, self._stale, self._silent, self._apart):
            found |= dict(part(pipeline, now_ns))
        return found

    def _is_now(self, name: str, count: int, now_ns: int) -> bool:
        """Whether a problem was there again in the last seconds, and is more than a backlog."""
        told = self._told.setdefault(name, _Told(0, now_ns, now_ns - _AGAIN_NS))
        if count != told.count:
            if now_ns - told.grown_ns >= _AGAIN_NS:
                told.since_ns = now_ns
            told.count, told.grown_ns = count, now_ns
        is_lasting = told.grown_ns - told.since_ns >= _STALE_NS
        return now_ns - told.grown_ns < _TOLD_NS and (is_lasting or not name.startswith(_BACKLOG))

    def _doubted(self, pipeline: Pipeline, _now_ns: int) -> Iterator[tuple[str, str]]:
        """Cameras and robots that say that they cannot be relied on."""
        moved = {f"camera {name}": text for name, text in pipeline.nudges.open.items()}
        clocks = pipeline.clocks.open
        for node in moved | clocks:
            said = [found[node] for found in (moved, clocks) if node in found]
            yield f"doubted {node}", "; ".join(said)

    def _apart(self, pipeline: Pipeline, now_ns: int) -> Iterator[tuple[str, str]]:
        """Cameras that see targets now, but never at a time from which there is odometry."""
        arrivals = pipeline.arrivals
        for camera, seen in arrivals.seen.items():
            if self._seen.get(camera, (None, 0))[0] != seen:
                self._seen[camera] = seen, now_ns
        for camera, text in arrivals.apart.items():
            seen, seen_ns = self._seen[camera]
            if seen.count >= _LEAST_SEEN and now_ns - seen_ns < _TOLD_NS:
                yield f"apart {camera}", f"camera {camera}: {text}"

    def _stale(self, pipeline: Pipeline, now_ns: int) -> Iterator[tuple[str, str]]:
        """Robots whose odometry has been old for seconds."""
        stale_ns = pipeline.stale_ns
        for robot in self._stale_since_ns.keys() - stale_ns.keys():
            del self._stale_since_ns[robot]
        for robot, behind_ns in stale_ns.items():
            since_ns = self._stale_since_ns.setdefault(robot, now_ns)
            if now_ns - since_ns >= _STALE_NS:
                yield (
                    f"stale {robot}",
                    f"the odometry of {robot} is stamped {to_seconds(behind_ns):.1f} s before what "
                    "came already and is not used until it is past that; was its clock set back?",
                )

    def _silent(self, pipeline: Pipeline, now_ns: int) -> Iterator[tuple[str, str]]:
        """Robots whose odometry has stopped while cameras see them."""
        for robot in self._site.robots:
            heard_ns = self._heard_ns.get(topics.ODOMETRY.key(self._site.name, robot))
            if heard_ns is None or now_ns - heard_ns < _STALE_NS or not pipeline.waits_for(robot):
                continue
            yield (
                f"silent {robot}",
                f"no odometry of {robot} for {to_seconds(now_ns - heard_ns):.0f} s while cameras "
                "see its target; check its bridge",
            )
