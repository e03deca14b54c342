"""The last hour, as it was."""

import random
import time

from trigpoint.tools.board.entities import Entities, Fields
from trigpoint.tools.board.feed import Feed
from trigpoint.tools.board.history import HOUR_S, History


def filled(seconds: int, begin: float = 1000.0) -> History:
    """A robot that goes 1 m a second along x; a camera that is there from second 30 to 90."""
    feed, history = Feed(), History()
    for tenth in range(10 * seconds):
        second, t = tenth / 10, begin + tenth / 10
        now: dict = {"robot/r1": {"at": [round(second, 1), 0.0, 0.0]}, "site": {"name": "lab"}}
        now["camera/c1"] = {"state": "located"} if 30 <= second < 90 else None
        history.keep(feed.update(now, t), feed.whole(), t)
    return history


def state(history: History, t: float) -> Entities:
    whole = history.at(t)
    assert whole is not None
    return whole.all


def test_nothing_is_kept_at_first() -> None:
    assert History().at(5.0) is None
    assert History().begin_s is None


def test_a_state_of_the_past_is_what_was_shown_then() -> None:
    history = filled(200)
    for second in (0, 29, 45, 59, 60, 61, 100, 150, 198):
        at = state(history, 1000.0 + second + 0.5)["robot/r1"]["at"]
        assert isinstance(at, list)
        assert abs(at[0] - second) <= 1.05
    assert "camera/c1" not in state(history, 1020.0)
    assert "camera/c1" in state(history, 1045.0)
    assert "camera/c1" in state(history, 1088.0)
    assert "camera/c1" not in state(history, 1110.0)
    assert state(history, 1110.0)["site"] == {"name": "lab"}


def test_before_the_begin_is_the_begin_and_after_the_end_the_end() -> None:
    history = filled(100)
    assert state(history, 0.0)["robot/r1"]["at"] == [0.0, 0.0, 0.0]
    assert state(history, 9e9)["robot/r1"]["at"] == [99.0, 0.0, 0.0]


def test_the_ways_are_those_of_the_minute_before() -> None:
    whole = filled(200).at(1150.2)
    assert whole is not None
    xs = whole.ways["robot/r1"][::2]
    assert 90 <= xs[0] <= 92
    assert 149 <= xs[-1] <= 150.2
    assert xs == sorted(xs)


def test_it_holds_an_hour_and_no_more() -> None:
    seconds = int(HOUR_S) + 600
    history = filled(seconds)
    begin_s = history.begin_s
    assert begin_s is not None
    assert HOUR_S <= 1000.0 + seconds - begin_s <= HOUR_S + 121
    assert history.size < 1_000_000


def test_packing_a_minute_holds_up_no_second() -> None:
    draw = random.Random(1)
    feed, history, took_s = Feed(), History(), []
    for second in range(90):
        now: dict[str, Fields | None] = {
            f"robot/r{i}": {"at": [draw.random() for _ in range(3)]} for i in range(200)
        }
        change, shown = feed.update(now, second), feed.whole()
        begin_s = time.thread_time()
        history.keep(change, shown, second)
        took_s.append(time.thread_time() - begin_s)
    assert max(took_s) < 0.2 * sum(took_s)
