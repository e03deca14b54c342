"""What a search tries beside its first answer."""

import pytest
from msgspec.structs import replace
from support.oracle.sessions import Shape, graph_of

from trigpoint.fusion.association.budget import Budget
from trigpoint.fusion.association.events import Events, window
from trigpoint.fusion.association.graph import Tie, Variant
from trigpoint.fusion.association.hypothesis import Hypothesis
from trigpoint.fusion.association.search import Search
from trigpoint.fusion.association.trail import Trail


@pytest.fixture(scope="module")
def search() -> Search:
    """Of a robot that camera c1 meets at its nodes 1, 3 and 4, and c2 at 2; nothing happened."""
    graph = graph_of(Shape(0, (0, 1, 0, 0), is_alike=False))
    return Search(graph, Events(), Budget())


def test_lift_is_tried_in_every_other_gap(search: Search) -> None:
    ties = {0: Tie(0, 0), 2: Tie(0, 0), 3: Tie(0, 0)}
    variant = Variant(ties, frozenset(), frozenset({("r1", 2)}))
    (lifted,) = search.placed([(Hypothesis(open={1: 0}), variant)])
    assert lifted.first_after_events(search.graph) == [2]
    others = search.lifted_elsewhere(lifted)
    assert {gap for each in others for _, gap in each.breaks} == {0, 1, 3}
    assert all(each.ties == ties and len(each.breaks) == 1 for each in others)


def test_moved_camera_is_shown_first_by_the_visit_at_its_new_place(search: Search) -> None:
    ties = {2: Tie(0, 1), 3: Tie(0, 1)}
    assert Hypothesis(ties, open={0: 0, 1: 0}).first_after_events(search.graph) == [2]


def test_visit_that_is_taken_to_be_wrong_explains_nothing(search: Search) -> None:
    numbers = range(4)
    best = search.explained([search.beginning()], numbers)[0]
    without = search.explained([search.beginning()], numbers, wrong=2)
    assert not best.nothing
    assert all(2 in each.nothing for each in without)
    assert without[0].score > best.score


def test_hypotheses_dropped_far_behind_what_is_known_cut_no_search(search: Search) -> None:
    own = Search(search.graph, Events(), Budget())
    many = [Hypothesis(open={0: 0}, score=100.0) for _ in range(129)]
    assert len(own._pruned(many, 100.0 - 2 * window())) == 128
    assert not own.is_cut
    own._pruned(many, 100.0)
    assert own.is_cut


def test_doubt_is_followed_while_it_is_not_far_behind_the_search_without_it(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers, trail = range(4), Trail(search.graph, range(4))
    visits, dear = search.visits, search.visits[2].nothing + 6 * window()
    visits = [*visits[:2], replace(visits[2], nothing=dear), *visits[3:]]
    monkeypatch.setattr(search, "visits", visits)
    best = search.explained([search.beginning()], numbers, trail=trail)[0]
    assert trail.least(4) == best.score
    alone = search.explained([search.beginning()], numbers, wrong=2)
    assert alone[0].score > best.score + 6 * window()
    assert not search.explained([search.beginning()], numbers, wrong=2, trail=trail)
    assert trail.least(4) == best.score
    monkeypatch.setattr(Trail, "least", lambda *_: alone[0].score - 5 * window())
    found = search.explained([search.beginning()], numbers, wrong=2, trail=trail)
    assert found[0].score == pytest.approx(alone[0].score)
