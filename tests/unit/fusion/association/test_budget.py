"""What a session is given up for is left open, and nothing else changes."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.oracle.sessions import Shape, data_of

from trigpoint.fusion.association import engine, search
from trigpoint.fusion.association.budget import Budget
from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.explanation import Explanation
from trigpoint.fusion.association.graph import Placed, Variant
from trigpoint.fusion.association.learning import SessionNoise, learnt_noise
from trigpoint.fusion.association.world import World
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation

Came = tuple[DataSet, list[Observation]]


@pytest.fixture(scope="module")
def came() -> Came:
    """Two cameras that were met twice, one by one."""
    return data_of(Shape(8, (0, 1, 0, 1), is_alike=False, is_near=True))


def within(came: Came, allowed: float) -> tuple[Explanation, Budget]:
    budget = Budget(allowed)
    return explain(*came, budget=budget), budget


@pytest.fixture(scope="module")
def whole(came: Came) -> tuple[Explanation, Budget]:
    """What all of it tells, and what that takes."""
    return within(came, np.inf)


def test_without_a_budget_nothing_is_located_or_called_anything_but_undecided(
    came: Came, whole: tuple[Explanation, Budget]
) -> None:
    explanation, budget = within(came, 0.0)
    assert explanation.findings.keys() == {"c1", "c2"}
    assert all("not decided in time" in f.reason for f in explanation.findings.values())
    assert not any(finding.alternatives for finding in explanation.findings.values())
    assert not explanation.places
    assert not explanation.lifts
    assert not explanation.moves
    assert budget.spent < 0.2 * whole[1].spent


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 0.999, 1.001])
def test_whatever_the_budget_what_is_located_is_where_it_is(
    came: Came, whole: tuple[Explanation, Budget], share: float
) -> None:
    everything, needed = whole
    found, _ = within(came, share * needed.spent)
    for camera, finding in found.findings.items():
        if finding.is_located:
            right = everything.findings[camera].alternatives[0].map_from_camera
            there = finding.alternatives[0].map_from_camera
            np.testing.assert_allclose(there.translation, right.translation, atol=1e-6)
        else:
            assert "not decided in time" in finding.reason
    located = {camera for camera, finding in found.findings.items() if finding.is_located}
    assert (located == {"c1", "c2"}) == (share > 1)
    assert {camera for camera, _ in found.places} <= located


def test_camera_with_undecided_pictures_is_left_open_and_no_other(
    came: Came, whole: tuple[Explanation, Budget]
) -> None:
    found = explain(*came, undecided=frozenset({"c2"}))
    (mine,), (expected,) = (e.findings["c1"].alternatives for e in (found, whole[0]))
    np.testing.assert_allclose(mine.covariance, expected.covariance, rtol=1e-6, atol=1e-12)
    assert not found.findings["c2"].is_located
    assert "not decided in time" in found.findings["c2"].reason
    assert {camera for camera, _ in found.places} == {"c1"}


def test_only_worlds_that_may_count_are_verified_the_likeliest_first(
    came: Came, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores: list[float] = []
    verified: list[float] = []

    class Watched(World):
        def __init__(self, *args, **more) -> None:
            super().__init__(*args, **more)
            # The second is far behind, and the third as good as the first.
            self.noise = replace(self.noise, score=200.0 * (len(scores) == 1))
            scores.append(self.score)

        def verify(self) -> None:
            verified.append(self.score)
            super().verify()

    def three(*args) -> tuple[dict[str, float], list[SessionNoise]]:
        scales, noises = learnt_noise(*args)
        return scales, [noises[0]] * 3

    monkeypatch.setattr(engine, "World", Watched)
    monkeypatch.setattr(engine, "learnt_noise", three)
    found = explain(*came)
    assert len(scores) == 3
    assert verified == [scores[0], scores[2]]
    assert all(finding.is_located for finding in found.findings.values())


def test_usual_session_takes_little_of_what_its_length_allows(
    came: Came, whole: tuple[Explanation, Budget]
) -> None:
    allowed = Budget.of(came[0].tracks.values()).allowed
    assert 0 < whole[1].spent < allowed / 10


def test_budget_grows_with_the_session(came: Came) -> None:
    (track,) = came[0].tracks.values()
    longer = Budget.of([track]).allowed - Budget.of([]).allowed
    assert longer == pytest.approx(0.09e6 * (track.last_ns - track.first_ns) / 1e9)


def test_what_more_explanations_hold_than_are_kept_is_left_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    came = data_of(Shape(2, (0, 1, 0, 1), is_alike=False, lift=2))
    assert not any("not decided" in f.reason for f in explain(*came).findings.values())
    graphs: list[bool] = []

    def noting(self: search.Search, variant: Variant) -> Placed | None:
        graphs.append(self.is_cut)
        return minimum(self, variant)

    minimum = search.Search._minimum
    monkeypatch.setattr(search.Search, "_minimum", noting)
    monkeypatch.setattr(search, "_MOST_HYPOTHESES", 1)
    narrow = explain(*came)
    assert all("not decided in time" in f.reason for f in narrow.findings.values())
    assert not narrow.places
    assert graphs
    assert not any(graphs)  # what is found once some are missing decides nothing
