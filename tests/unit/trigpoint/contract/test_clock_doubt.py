"""Which diagnostics need to be read for who cannot be relied on."""

from trigpoint.contract.cdr import encode
from trigpoint.contract.clock_doubt import CLOCK_OFF_BY, DoubtFilter
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.contract.nudge import NUDGED


def saying(**values: str) -> bytes:
    return encode(Diagnostics(1, (DiagnosticStatus(0, "edge/c1", "running", "host", values),)))


def test_all_are_read_behind_the_first_doubtful_clock_since_one_that_is_right_says_nothing() -> (
    None
):
    doubts = DoubtFilter()
    assert not doubts.wants(saying(pictures="7"))
    assert doubts.wants(saying(**{NUDGED: "1 2"}))
    assert not doubts.wants(saying(pictures="8"))
    assert doubts.wants(saying(**{CLOCK_OFF_BY: "+0.300"}))
    assert doubts.wants(saying(pictures="9"))
