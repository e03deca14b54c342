"""Of what comes by several ways the first copy counts, and nothing that was overtaken."""

import threading
import time

from hypothesis import given
from hypothesis import strategies as st

from trigpoint.bus.urgent import Newest

KEY = "lab/robot/r1/correction"


@given(st.lists(st.integers(0, 50)))
def test_what_passes_is_each_time_newer(stamps: list[int]) -> None:
    newest, passed = Newest(), list[int]()
    for stamp in stamps:
        newest.hand_on(KEY, "fusion", stamp, lambda stamp=stamp: passed.append(stamp))
    assert passed == sorted(set(passed))
    assert passed[-1:] == ([max(stamps)] if stamps else [])


def test_robots_and_senders_have_times_of_their_own() -> None:
    newest, passed = Newest(), list[str]()
    newest.hand_on(KEY, "fusion", 5, lambda: passed.append("first"))
    newest.hand_on(KEY, "fusion", 5, lambda: passed.append("copy"))
    newest.hand_on("lab/robot/r2/correction", "fusion", 5, lambda: passed.append("other robot"))
    # Fusion begins anew on a machine whose clock was set back.
    newest.hand_on(KEY, "its next life", 3, lambda: passed.append("next life"))
    assert passed == ["first", "other robot", "next life"]


def test_what_is_handed_on_is_not_overtaken_on_its_way() -> None:
    """One thread has been let through and is slow to hand on; a newer one waits for it."""
    newest, passed = Newest(), list[int]()
    begun, coming = threading.Event(), threading.Event()

    def slowly() -> None:
        begun.set()
        coming.wait(60.0)
        time.sleep(0.02)
        passed.append(1)

    newer = threading.Thread(
        target=lambda: newest.hand_on(KEY, "fusion", 2, lambda: passed.append(2))
    )
    older = threading.Thread(target=lambda: newest.hand_on(KEY, "fusion", 1, slowly))
    older.start()
    begun.wait()
    newer.start()
    coming.set()
    older.join()
    newer.join()
    assert passed == [1, 2]
