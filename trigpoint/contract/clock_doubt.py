"""What a node says in its diagnostics of a clock that cannot be relied on; and which diagnostics
may say of anything that it cannot be.

Said once a second for as long as it lasts; diagnostics may be lost.
"""

import math

from trigpoint.contract.messages import DiagnosticStatus
from trigpoint.contract.nudge import may_tell_of_nudges

CLOCK_SET_BY = "clock_set_by"
"""The value of a node whose machine's clock was set and is not followed yet: by how many
seconds."""
CLOCK_OFF_BY = "clock_off_by"
"""The value of a camera or robot whose clock is certainly off from fusion's by more than is borne:
how many seconds it is ahead."""
REFUSED_FROM = 3.0
"""What a camera sees of a robot is refused from this many times the offset that is borne, until the
offset is borne again. Below it nodes warn: clocks that are set by SNTP are 10 to 20 ms off, which
is 3 to 6 mm at 0.3 m/s, and to see nothing would cost more."""


class DoubtFilter:
    """Which encoded diagnostics may say that a camera or robot cannot be relied on, or no longer;
    most say nothing of that, and need not be decoded."""

    def __init__(self) -> None:
        self._had_clock = False

    def wants(self, payload: bytes) -> bool:
        """Whether these may; behind the first doubtful clock all may, since one that is right again
        says nothing."""
        self._had_clock |= CLOCK_SET_BY.encode() in payload or CLOCK_OFF_BY.encode() in payload
        return self._had_clock or may_tell_of_nudges(payload)


def ahead_s(status: DiagnosticStatus) -> float:
    """By how much a node says that its clock is ahead of fusion's; 0 where it says nothing of the
    kind."""
    try:
        found = float(status.values.get(CLOCK_OFF_BY, "0"))
    except ValueError:
        return 0.0
    return found if math.isfinite(found) else 0.0
