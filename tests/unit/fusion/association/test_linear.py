"""A visit linearised by the core is that of numpy, with every kind of unknown."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion import small_problems
from support.fusion.picture_jitter import base_jacobian
from support.fusion.slow_linear import SlowLinear, slow_linear
from support.fusion.small_problems import first_state, small_data

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.linear import LINEARISED, Linear, linearised, unknowns_of
from trigpoint.fusion.association.sightings import all_without_wild
from trigpoint.fusion.association.trial import Ending, Pictures, Trial, Work
from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.prediction import batch_residual
from trigpoint.fusion.model.problem import State
from trigpoint.geometry import Pose

PAIRS = [("c1", "r2"), ("c2", "r1")]
WRONG, DISPLACED = 3, 7  # views, of which each picture has two


@pytest.fixture(autouse=True)
def many_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of so few as a small problem has, it cannot be told which are wild."""
    monkeypatch.setattr(small_problems, "EVERY_CORNER", 2)


def visit(camera: str, robot: str) -> tuple[DataSet, Trial]:
    """Pictures of a robot by one camera, with some wild corners, and a view that is wrong."""
    data = small_data(noise_px=0.2, line_delay_s=1e-4, sightings=24)
    data.entries = [
        e for e in data.entries if (e.observation.camera, e.observation.robot) == (camera, robot)
    ]
    for entry in data.entries[::2]:
        entry.observation.views[1].pixels[0] += 30.0
    seen = [entry.observation for entry in data.entries]
    poses = Pose.stack([e.map_from_base for e in data.entries if e.map_from_base is not None])
    wrong = np.arange(2 * len(seen)) == WRONG
    start = first_state(data, off=0.3).cameras[camera]
    return data, Trial(Pictures(data, seen, Events()), start, poses, wrong)


def assembled(data: DataSet, trial: Trial) -> Assembled:
    """The same problem as any other is made, with every corner of every view."""
    state = State({trial.pictures.camera: trial.camera}, trial.pictures.robots)
    return assemble(data, state, list(range(len(data.entries))), anchored=False)


def weighed(problem: Assembled, weights: np.ndarray) -> Assembled:
    (batch,) = problem.problem.batches
    return replace(
        problem, problem=replace(problem.problem, batches=(replace(batch, weights=weights),))
    )


def assert_same(found: Linear, expected: SlowLinear, problem: Assembled, trial: Trial) -> None:
    layout, robot = problem.problem.layout, trial.pictures.robot
    own = unknowns_of(problem.problem, trial.pictures.camera)
    columns = [*own, *layout.scales[robot], *layout.faces[robot]]
    for mine, other in (
        *((found.shifts, expected.shifts), (found.own, expected.own)),
        *((found.by_robot, expected.by_robot), (found.by_others, expected.by_others[..., columns])),
        *((found.steps, expected.steps), (found.by_earlier, expected.by_earlier)),
        (found.by_later, expected.by_later),
        (found.steps_by_others[..., len(own) : len(own) + 2], expected.by_scale),
    ):
        np.testing.assert_allclose(mine, other, rtol=1e-7, atol=1e-9 * np.abs(other).max())
    np.testing.assert_array_equal(found.nodes, expected.nodes)


@pytest.mark.parametrize(("camera", "robot"), PAIRS)
def test_pictures_are_linearised_without_what_is_wrong_or_wild(camera: str, robot: str) -> None:
    data, trial = visit(camera, robot)
    trial.wild[::5] = True
    found, problem = linearised(trial, by_pictures=True), assembled(data, trial)
    assert found is not None
    (batch,) = problem.problem.batches
    weights = batch.weights.copy()
    parts = [part for entry in data.entries for part in entry.observation.parts]
    flags = trial.pictures.split(trial.wild)
    for view, (part, wild) in enumerate(zip(parts, flags, strict=True)):
        weights[view // 2, part] *= ~wild & (view != WRONG)
    rows = [(row, slice(None)) for row in range(len(data.entries))]
    assert_same(found, slow_linear(weighed(problem, weights), rows), problem, trial)
    assert found.parts == list(range(len(data.entries)))


@pytest.mark.parametrize(("camera", "robot"), PAIRS)
def test_views_are_linearised_each_without_its_own_wild_corners(camera: str, robot: str) -> None:
    data, trial = visit(camera, robot)
    found, problem = linearised(trial, by_pictures=False), assembled(data, trial)
    assert found is not None
    (batch,) = problem.problem.batches
    residual, by_base = batch_residual(batch, problem.start), base_jacobian(batch, problem.start)
    weights, shown = batch.weights.copy(), []
    parts = [part for entry in data.entries for part in entry.observation.parts]
    for view, part in enumerate(parts):
        one = by_base[view // 2, part][None], residual[view // 2, part][None]
        (wild,) = all_without_wild(*one, Events().wild_score)[1]
        weights[view // 2, part] *= ~wild
        if view != WRONG:
            shown.append((view // 2, part))
    assert np.any(weights != batch.weights)
    assert_same(found, slow_linear(weighed(problem, weights), shown), problem, trial)
    assert WRONG not in found.parts


@pytest.mark.parametrize(("camera", "robot"), PAIRS)
def test_round_finds_the_view_that_is_displaced_and_the_one_that_is_not(
    camera: str, robot: str
) -> None:
    data, trial = visit(camera, robot)
    displaced = trial.pictures.views[DISPLACED]
    displaced.pixels[:] += 25.0
    pictures = Pictures(data, trial.pictures.observations, Events())
    trial = Trial(pictures, trial.camera, trial.poses, trial.wrong)
    both = Work.SOLVE | Work.JUDGE
    assert trial.round(both | Work.ROBUST, huber=3.0) is Ending.JUDGED_OTHERWISE
    for _ in range(4):
        trial.round(both)
    assert np.flatnonzero(trial.wrong).tolist() == [DISPLACED]
    wild = [np.flatnonzero(flags).tolist() for flags in trial.pictures.split(trial.wild)]
    for view in range(1, len(wild), 2):
        if view != DISPLACED:
            assert wild[view] == ([0] if view // 2 % 2 == 0 else [])
    error = trial.camera.map_from_camera.difference(
        first_state(data).cameras[camera].map_from_camera
    )
    system = trial.equations.system()
    rows = system.dense_row + unknowns_of(trial.tables.assembled.problem, camera)[:6]
    known = np.linalg.inv(system.covariance[np.ix_(rows, rows)])
    assert error @ known @ error < Events().sighting_gate


@pytest.mark.parametrize("offset_s", [1e12, np.inf, np.nan])
def test_clock_that_diverges_fits_nothing(offset_s: float) -> None:
    _, trial = visit(*PAIRS[0])
    trial._state[2][0, 0] = offset_s
    assert trial.round(Work.READ | Work.SOLVE) is Ending.NOTHING_FITS


@pytest.mark.parametrize("d", [0, 2, 7])
def test_parts_of_a_robot_with_other_unknowns_are_refused(d: int) -> None:
    """Their coefficients would be written, or read, beside the arrays that they are in."""
    _, trial = visit("c2", "r1")
    found = linearised(trial, by_pictures=True)
    assert found is not None
    assert d != found.steps.shape[1]
    q, parts, steps = found.by_others.shape[2], len(trial.pictures.observations), len(found.steps)
    numbers = [np.empty(parts, np.int64) for _ in range(2)]
    of_parts = [np.empty((parts, 6, *shape)) for shape in ((), (6,), (d,), (q,))]
    of_steps = [np.empty((steps, d, *shape)) for shape in ((), (d,), (d,), (q,))]
    with pytest.raises(RuntimeError, match="parts of other unknowns"):
        LINEARISED(*trial.given(Work(0)), True, *numbers, *of_parts, *of_steps)
