"""Of what comes by several ways the first copy counts, and nothing that was overtaken."""

from hypothesis import given
from hypothesis import strategies as st

from trigpoint.bus_urgent import Newest

KEY = "lab/robot/r1/correction"


@given(st.lists(st.integers(0, 50)))
def test_what_passes_is_each_time_newer(stamps: list[int]) -> None:
    newest = Newest()
    passed = [stamp for stamp in stamps if newest.is_new(KEY, "fusion", stamp)]
    assert passed == sorted(set(passed))
    assert passed[-1:] == ([max(stamps)] if stamps else [])


def test_robots_and_senders_have_times_of_their_own() -> None:
    newest = Newest()
    assert newest.is_new(KEY, "fusion", 5)
    assert not newest.is_new(KEY, "fusion", 5)
    assert newest.is_new("lab/robot/r2/correction", "fusion", 5)
    # Fusion begins anew on a machine whose clock was set back.
    assert newest.is_new(KEY, "its next life", 3)
