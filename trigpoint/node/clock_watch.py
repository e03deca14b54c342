"""Whether this machine's clock agrees with fusion's, by asking it: certain to half a round trip.

What is stamped by a clock that is off by δ is taken for what was δ earlier or later, and so is
wrong by the robot's speed times δ.
"""

import json
from collections import deque
from collections.abc import Callable

from msgspec import Struct

from trigpoint.base.clock import STEP_NS, to_seconds
from trigpoint.bus.bus import Bus, Reply
from trigpoint.contract.clock_doubt import CLOCK_OFF_BY
from trigpoint.contract.topics import command_key
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse
from trigpoint.site.config import Site

CLOCK_IS_OFF = "clock offset"
"""The name under which a health holds it."""
_ASK_EVERY_S = 2.0
_ANSWER_S = 1.0
_KEPT = 8
"""Of this many queries, the one answered soonest counts; where none was, nothing is known."""


class ClockOffset(Struct, frozen=True):
    """Fusion's clock minus ours, seconds; the true value is within `uncertainty_s` of it."""

    offset_s: float
    uncertainty_s: float

    def exceeds(self, limit_s: float) -> bool:
        """Whether the clock is certainly off by more than this."""
        return abs(self.offset_s) - self.uncertainty_s > limit_s


class ClockWatch:
    """A node's thread that asks fusion for its time. `now_ns`: Unix time by the node's stamps;
    `limit_s`: the offset that is borne; `harm`: what one beyond that does, in words."""

    def __init__(
        self,
        bus: Bus,
        node: Node,
        site: Site,
        now_ns: Callable[[], int],
        limit_s: float,
        harm: str,
    ) -> None:
        self._bus, self._node, self._now_ns = bus, node, now_ns
        self._limit_s, self._harm = limit_s, harm
        self._key = command_key(site.name, "clock")
        self._offsets: deque[ClockOffset | None] = deque(maxlen=_KEPT)
        self._course_ns = 0
        self.is_off = False
        node.health.gauge("clock_offset_ms", self._offset_ms)
        node.health.gauge(CLOCK_OFF_BY, self._off_by_s)

    @property
    def _best(self) -> ClockOffset | None:
        known = [one for one in list(self._offsets) if one is not None]
        return min(known, key=lambda one: one.uncertainty_s, default=None)

    def _offset_ms(self) -> float | None:
        best = self._best
        return None if best is None else 1e3 * best.offset_s

    def _off_by_s(self) -> float | None:
        """How far ahead this clock is, where that is certainly more than is borne."""
        best = self._best
        return None if best is None or not self.is_off else round(-best.offset_s, 3)

    def run(self, pulse: Pulse) -> None:
        """Ask until the node stops."""
        while True:
            pulse.beat()
            self.ask()
            if self._node.stopping.wait(_ASK_EVERY_S):
                return

    def ask(self) -> None:
        """Ask once; if nobody answers, what is known stays for as long as it is among those kept.
        What was learnt before this machine's clock was set is forgotten."""
        elapsed_ns = self._node.clock.elapsed_ns
        began_ns = elapsed_ns()
        before_ns = self._now_ns()
        self._follow(before_ns - began_ns)
        replies = self._bus.query(self._key, timeout_s=_ANSWER_S)
        after_ns = self._now_ns()
        ended_ns = elapsed_ns()
        theirs = [found for reply in replies if (found := _now_ns(reply)) is not None]
        offset = None
        if not self._follow(after_ns - ended_ns) and len(theirs) == 1:
            half_ns = (ended_ns - began_ns) // 2
            offset = ClockOffset(to_seconds(theirs[0] - before_ns - half_ns), to_seconds(half_ns))
        self._offsets.append(offset)
        self._judge()

    def _follow(self, course_ns: int) -> bool:
        """Whether this machine's clock was set since the last call; `course_ns`: its Unix time
        less its monotonic time."""
        is_set = abs(course_ns - self._course_ns) >= STEP_NS
        if is_set:
            self._course_ns = course_ns
            self._offsets.clear()
        return is_set

    def _judge(self) -> None:
        best, health = self._best, self._node.health
        self.is_off = best is not None and best.exceeds(self._limit_s)
        if best is None or not self.is_off:
            health.release(CLOCK_IS_OFF)
            return
        side = "behind" if best.offset_s > 0 else "ahead of"
        health.hold(
            CLOCK_IS_OFF,
            f"this machine's clock is {abs(best.offset_s):.3f} s {side} fusion's, where "
            f"{self._limit_s:.3f} s are borne: {self._harm}; synchronise the clocks "
            "(trigpoint doctor)",
        )


def _now_ns(reply: Reply) -> int | None:
    """The time in a reply; None if it is an error or holds none."""
    if reply.error:
        return None
    try:
        return int(json.loads(reply.payload)["now_ns"])
    except (ValueError, KeyError, TypeError):
        return None
