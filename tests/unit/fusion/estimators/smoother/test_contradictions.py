"""Sightings that contradict a solution are left out of it."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.small_problems import first_state, small_data

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.estimators.smoother.batch import leave_out_contradicting
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.solver.levenberg_marquardt import solve_consistently


def with_one_picture_by_c2(displaced_px: float) -> DataSet:
    """Two faces in one picture alone tell where c2 is, and one of them is displaced."""
    data = small_data(noise_px=0.2, sightings=24)
    of_c2 = [entry for entry in data.entries if entry.observation.camera == "c2"]
    data.entries[:] = [entry for entry in data.entries if entry not in of_c2[1:]]
    first, *others = of_c2[0].observation.views
    moved = replace(first, pixels=first.pixels + np.array([displaced_px, 0.0]))
    of_c2[0].observation = replace(of_c2[0].observation, views=(moved, *others))
    return data


def left_out(data: DataSet) -> list[list[bool]]:
    """By picture of c2, which of its sightings are left out once a solution was judged."""
    solved = solve_consistently(data, first_state(data), tolerance=1e-4)
    assert solved is not None
    leave_out_contradicting(data, solved, Events())
    seen = [entry.observation for entry in data.entries if entry.observation.camera == "c2"]
    return [[bool(np.all(wild)) for wild in each.wild] for each in seen]


@pytest.mark.parametrize(("displaced_px", "count"), [(0.0, 0), (8.0, 1)])
def test_of_two_sightings_in_a_picture_that_contradict_each_other_one_is_left_out(
    displaced_px: float, count: int
) -> None:
    """Both look alike bad, and without both nothing would tell where the camera is."""
    (flags,) = left_out(with_one_picture_by_c2(displaced_px))
    assert sum(flags) == count


def test_picture_of_which_nothing_is_left_is_rejected() -> None:
    data = small_data(noise_px=0.2, sightings=24)
    entry = data.entries[4]
    first, *others = entry.observation.views
    moved = replace(first, pixels=first.pixels + np.array([25.0, 0.0]))
    seen = replace(entry.observation, views=(moved, *others))
    none, *rest = seen.wild
    entry.observation = seen.with_outliers((none, *map(np.ones_like, rest)))
    left_out(data)
    assert entry.observation.verdict is Verdict.REJECTED
