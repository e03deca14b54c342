"""The counts of a board whose answer says neither how wide they are nor whether they began anew.

Both are decided by what is likely: no wheel turns further in the time between two answers than the
site file's `max_speed` and `max_turn` allow; and counts near zero after a silence belong to a board
that restarted, unless the robot may have been on its way there.
"""

from msgspec import Struct

from trigpoint.base.clock import to_seconds
from trigpoint.site.config import RobotConfig

from .limits import JITTER_S
from .wheels import WheelGeometry, nearest

USUAL_BITS, NARROW_BITS = 32, 16
LEFT, RIGHT, UNUSED = "l", "r", "-"
Counts = list[float]
# Boards are asked at least ten times a second: two answers in a row are missing.
SILENT_S = 0.25
# A board that restarted answers this soon after it began to count.
_BEGUN_S = 0.25


class Turned(Struct, frozen=True):
    """How far the wheels turned since the last answer. `restarted`: the board counts anew, and how
    far they turned is unknown; `narrowed`: the counts were just found to be of 16 bits."""

    left_m: float
    right_m: float
    elapsed_s: float
    restarted: bool = False
    narrowed: bool = False


class Encoders:
    """One board's counters, `config.wheels.order` saying which is which. Not thread-safe."""

    def __init__(self, config: RobotConfig, geometry: WheelGeometry) -> None:
        self._order, self._is_stated = config.wheels.order, config.wheels.bits is not None
        self._wheels = self._order.replace(UNUSED, "")
        self._bits = config.wheels.bits or USUAL_BITS
        self._metres = {LEFT: geometry.left_m, RIGHT: geometry.right_m}
        self._fastest = config.max_speed + 0.5 * config.max_turn * geometry.track_m
        self._counts: Counts | None = None
        self._rates: list[float] = []
        self._stamp_ns = 0

    @property
    def columns(self) -> int:
        """How many numbers an answer has."""
        return len(self._order)

    def counts(self, numbers: list[float]) -> Counts | None:
        """The wheels' counts among an answer's numbers; None if counters of this width, signed or
        not, cannot read so."""
        pairs = zip(self._order, numbers, strict=True)
        found = [number for wheel, number in pairs if wheel != UNUSED]
        return found if _fit(found, self._bits) else None

    def add(self, counts: Counts, stamp_ns: int) -> Turned:
        """How far the wheels turned until these counts; the first are where they start."""
        before, self._counts = self._counts, counts
        elapsed_s = to_seconds(stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns
        if before is None:
            self._rates = [0.0] * len(counts)
            return Turned(0.0, 0.0, 0.0)
        steps = _steps(before, counts, self._bits)
        narrowed = self._narrows(before, counts, steps, elapsed_s)
        if narrowed:
            self._bits = NARROW_BITS
            steps = _steps(before, counts, self._bits)
        if self._restarted(counts, steps, elapsed_s):
            self._rates = [0.0] * len(counts)
            return Turned(0.0, 0.0, elapsed_s, restarted=True)
        if elapsed_s > 0:
            self._rates = [step / elapsed_s for step in steps]
        left_m, right_m = (self._mean_m(steps, wheel) for wheel in (LEFT, RIGHT))
        return Turned(left_m, right_m, elapsed_s, narrowed=narrowed)

    def _narrows(self, before: Counts, counts: Counts, steps: Counts, elapsed_s: float) -> bool:
        """Whether the step is possible only where the counters wrapped at 16 bits. Not after a
        silence: then a wheel may have gone so far that a restart could pass for a wrap."""
        if self._is_stated or self._is_possible(steps, elapsed_s):
            return False
        return (
            elapsed_s < SILENT_S
            and _fit(before, NARROW_BITS)
            and _fit(counts, NARROW_BITS)
            and self._is_possible(_steps(before, counts, NARROW_BITS), elapsed_s)
        )

    def _restarted(self, counts: Counts, steps: Counts, elapsed_s: float) -> bool:
        if elapsed_s < SILENT_S and self._is_possible(steps, elapsed_s):
            return False
        from_zero_m = self._furthest_m(counts)
        # A robot that went on is somewhere between where it was and where it was heading.
        from_likely = [
            _outside(step, rate * elapsed_s) for step, rate in zip(steps, self._rates, strict=True)
        ]
        is_near = from_zero_m <= self._fastest * _BEGUN_S
        return is_near and from_zero_m < self._furthest_m(from_likely)

    def _is_possible(self, steps: Counts, elapsed_s: float) -> bool:
        return self._furthest_m(steps) <= self._fastest * (elapsed_s + JITTER_S)

    def _furthest_m(self, counts: Counts) -> float:
        """The longest way of a wheel, from counts since it was where they are zero."""
        return max(
            abs(count * self._metres[wheel])
            for wheel, count in zip(self._wheels, counts, strict=True)
        )

    def _mean_m(self, steps: Counts, side: str) -> float:
        """The way of a side's wheels, on average."""
        ways = [step for wheel, step in zip(self._wheels, steps, strict=True) if wheel == side]
        return self._metres[side] * sum(ways) / len(ways)


def _steps(before: Counts, counts: Counts, bits: int) -> Counts:
    return [nearest(new - old, bits) for old, new in zip(before, counts, strict=True)]


def _outside(step: float, heading: float) -> float:
    """How far a step is from all those between none and `heading`."""
    low, high = min(heading, 0.0), max(heading, 0.0)
    return max(low - step, step - high, 0.0)


def _fit(counts: Counts, bits: int) -> bool:
    return all(-(2 ** (bits - 1)) <= count < 2**bits for count in counts)
