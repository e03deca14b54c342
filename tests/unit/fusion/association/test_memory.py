"""What an explanation worked out is kept for the next one over more of the same session."""

import numpy as np
import pytest
from support.oracle.sessions import Shape, data_of

from trigpoint.fusion.association.budget import Budget
from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.explanation import Explanation
from trigpoint.fusion.association.modes import Memory
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation


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
