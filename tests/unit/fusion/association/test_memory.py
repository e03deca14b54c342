"""What an explanation worked out is kept for the next one over more of the same session."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.oracle.sessions import Shape, data_of

from trigpoint.fusion.association.budget import Budget
from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.explanation import Explanation
from trigpoint.fusion.association.memory import Memory
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.past import Past


@pytest.fixture(scope="module")
def came() -> tuple[DataSet, list[Observation]]:
    """Two cameras that were met three times each."""
    return data_of(Shape(8, (0, 1, 0, 1, 0, 1), is_alike=False, is_near=True))


def spent(
    data: DataSet, observations: list[Observation], memory: Memory
) -> tuple[Explanation, float]:
    budget = Budget()
    return explain(data, observations, memory, budget), budget.spent


def test_late_sighting_leaves_what_is_known_of_other_visits(
    came: tuple[DataSet, list[Observation]],
) -> None:
    data, observations = came
    memory, late = Memory(), 2
    spent(data, observations[:late] + observations[late + 1 :], memory)
    found, second = spent(data, observations, memory)
    alone, anew = spent(data, observations, Memory())
    assert second < 0.7 * anew
    for camera, finding in alone.findings.items():
        right = finding.alternatives[0].map_from_camera
        there = found.findings[camera].alternatives[0].map_from_camera
        np.testing.assert_allclose(there.translation, right.translation, atol=1e-9)
    assert [read.readings for read in found.reads] == [read.readings for read in alone.reads]


def test_nothing_new_is_explained_by_what_is_known(
    came: tuple[DataSet, list[Observation]],
) -> None:
    memory = Memory()
    _, first = spent(*came, memory)
    _, second = spent(*came, memory)
    assert second < 0.3 * first


def test_cameras_that_the_past_knows_are_not_asked_for_again(
    came: tuple[DataSet, list[Observation]],
) -> None:
    """Where else they may be was asked when the past was made."""
    data, observations = came
    before, _ = spent(data, observations, Memory())
    places = {name: finding.alternatives[0] for name, finding in before.findings.items()}
    information = np.zeros((6 * len(places),) * 2)
    for row, place in enumerate(places.values()):
        own = slice(6 * row, 6 * row + 6)
        information[own, own] = np.linalg.inv(place.covariance)
    poses = {name: place.map_from_camera for name, place in places.items()}
    known = KnownCameras(poses, information)
    given = replace(data, known=known)
    settled = replace(given, past=Past(known, {}, None, data.epoch_ns, {}))
    of_given, work = spent(given, observations, Memory())
    of_settled, less = spent(settled, observations, Memory())
    assert less < 0.9 * work
    assert [read.readings for read in of_settled.reads] == [r.readings for r in of_given.reads]
    assert all(finding.is_located for finding in of_given.findings.values())
    assert all(finding.is_located for finding in of_settled.findings.values())


def test_a_visit_as_expected_asks_no_other_camera_anew() -> None:
    data, observations = data_of(Shape(0, (0, 1, 0, 1, 0, 1, 0, 1), is_alike=False))
    works = []
    for is_verified in (True, False):
        memory = Memory()
        spent(data, observations[:-1], memory)
        for trail in memory.trails:
            assert trail.verified == {"c1", "c2"}
            trail.verified &= frozenset({"c1", "c2"} if is_verified else ())
        found, work = spent(data, observations, memory)
        assert all(finding.is_located for finding in found.findings.values())
        works.append(work)
    assert works[0] < 0.9 * works[1]


@pytest.mark.parametrize(
    "shape",
    [
        Shape(0, (0, 1, 0, 1, 0), is_alike=False),
        Shape(3, (0, 1, 0, 0), is_alike=True),
        Shape(4, (0, 1, 0, 1, 0), is_alike=False, lift=3),
        Shape(6, (0, 1, 0, 0, 1), is_alike=True, displaced=(1, 3)),
    ],
)
def test_explained_bit_by_bit_it_is_what_it_is_at_once(shape: Shape) -> None:
    data, observations = data_of(shape)
    memory = Memory()
    arrival = [0, *range(2, len(observations)), 1]  # one of the first comes last
    for count in range(1, len(observations)):
        spent(data, [observations[n] for n in sorted(arrival[:count])], memory)
    found, last = spent(data, observations, memory)
    alone, anew = spent(data, observations, Memory())
    assert last < anew
    assert [read.readings for read in found.reads] == [read.readings for read in alone.reads]
    assert found.lifts == alone.lifts
    assert len(found.moves) == len(alone.moves)
    for camera, finding in alone.findings.items():
        pairs = zip(found.findings[camera].alternatives, finding.alternatives, strict=True)
        for there, right in pairs:
            assert there.probability == pytest.approx(right.probability, rel=1e-3)
            apart = there.map_from_camera.difference(right.map_from_camera)
            np.testing.assert_allclose(apart, 0.0, atol=1e-4)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9])
def test_what_a_short_budget_left_out_is_found_once_there_is_more(share: float) -> None:
    data, observations = data_of(Shape(0, (0, 1, 0, 1, 0), is_alike=False))
    alone, needed = spent(data, observations, Memory())
    memory = Memory()
    explain(data, observations, memory, Budget(share * needed))
    found, _ = spent(data, observations, memory)
    assert [read.readings for read in found.reads] == [read.readings for read in alone.reads]
    for camera, finding in alone.findings.items():
        assert found.findings[camera].is_located == finding.is_located


def test_third_explanation_goes_on_from_where_the_second_did() -> None:
    data, observations = data_of(Shape(0, (0, 1, 0, 1, 0), is_alike=False))
    memory = Memory()
    work = [spent(data, observations, memory)[1] for _ in range(4)]
    assert work[1] == pytest.approx(work[2])
    assert work[2] == pytest.approx(work[3])
