"""Alarms have the words of `status`, and times."""

import pytest

from trigpoint.contract.messages import DiagnosticStatus
from trigpoint.tools.board.alarms import Alarms
from trigpoint.tools.board.entities import Fields
from trigpoint.tools.board.feed import Feed
from trigpoint.tools.site.state import SiteStatus, summarise, table


def status_of(text: str, level: int = 2) -> SiteStatus:
    one = DiagnosticStatus(level, "edge/c1", text, "pc", {"picture_age_s": "12.3", "a.lost": "3"})
    return summarise("lab", peers=1, tokens=["lab/alive/edge/c1"], statuses=[one])


def alarms_in(entities: dict[str, Fields | None]) -> list[Fields]:
    return [f for name, f in entities.items() if name.startswith("alarm/") and f is not None]


def test_an_alarm_keeps_its_begin_while_its_numbers_grow_and_ends() -> None:
    alarms = Alarms()
    first = alarms_in(alarms.look(status_of("frozen for 5 s"), 100.0))
    assert first == [{"node": "edge/c1", "text": "frozen for 5 s", "state": "error", "since": 100}]
    second = alarms_in(alarms.look(status_of("frozen for 6 s"), 101.0))
    assert second == [first[0] | {"text": "frozen for 6 s"}]
    assert alarms_in(alarms.look(status_of("running", 0), 102.0)) == []
    assert alarms_in(alarms.look(status_of("running", 0), 105.0)) == [{"until": 101}]


def test_a_node_that_ended_does_not_say_that_it_runs() -> None:
    last = DiagnosticStatus(0, "edge/c1", "running", "pc", {})
    status = summarise("lab", peers=1, tokens=[], statuses=[last])
    assert alarms_in(Alarms().look(status, 0.0))[0]["text"] == "gone"


def test_the_same_trouble_later_is_another_alarm() -> None:
    alarms = Alarms()
    names = set()
    for t in (0.0, 100.0, 200.0):
        names |= {n for n in alarms.look(status_of("lost"), t) if n.startswith("alarm/")}
        alarms.look(status_of("running", 0), t + 10)
    assert names == {"alarm/1", "alarm/2", "alarm/3"}


def test_alarms_that_are_over_are_forgotten_some_day() -> None:
    alarms, shown = Alarms(), {}
    for number in range(100):
        for status, t in ((status_of("lost"), 0.0), (status_of("running", 0), 10.0)):
            shown |= alarms.look(status, 100.0 * number + t)
            shown = {name: fields for name, fields in shown.items() if fields is not None}
    assert sum(name.startswith("alarm/") for name in shown) == 40


def test_a_node_is_said_in_the_words_of_status() -> None:
    status = status_of("the picture has not changed")
    node = Alarms().look(status, 0.0)["node/edge/c1"]
    assert node is not None
    notes = node["notes"]
    assert isinstance(notes, list)
    assert all(note in table(status) for note in notes)
    assert (node["age"], node["lost"]) == (12, 3)


@pytest.mark.parametrize("state", ["silent", "gone"])
def test_an_agent_that_says_nothing_says_no_age_of_its_pictures(state: str) -> None:
    feed, alarms = Feed(), Alarms()
    one = DiagnosticStatus(
        0, "edge/c1", "running", "pc", {"picture_age_s": "0.1", "source": "runs"}
    )
    tokens, later = ["lab/alive/edge/c1"], [] if state == "silent" else [one]
    for alive, statuses in ((tokens, [one]), (tokens if state == "silent" else [], later)):
        status = summarise("lab", peers=1, tokens=alive, statuses=statuses)
        feed.update(alarms.look(status, 0.0), 0.0)
    node = feed.whole()["node/edge/c1"]
    assert (node["state"], node["age"], node["source"]) == (state, None, None)


def test_a_node_that_is_gone_from_the_look_is_gone_from_the_page() -> None:
    alarms = Alarms()
    alarms.look(status_of("running", 0), 0.0)
    assert alarms.look(SiteStatus("lab", 0, []), 1.0)["node/edge/c1"] is None
