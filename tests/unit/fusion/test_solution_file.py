"""Corrections after a restart: from the last solution at once, and as true as before it."""

import logging
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Session
from support.fusion.networks import assert_same_places
from support.fusion.solvers import SlowSolver

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import PoseEstimate
from trigpoint.fusion.checked_file import save_checked
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.inbox import Input
from trigpoint.fusion.live.solver_messages import Solved
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.replaying import replayed
from trigpoint.fusion.solution_file import SOLUTION, SolutionFile
from trigpoint.node.watchdog import Watchdog

Messages = tuple[tuple[str, Input], ...]
PLANE = [0, 1, 5]
NEVER = 10**9
STOP_S = 10.0
PATIENCE_S = 60.0
NOW_NS = EPOCH_NS + to_ns(STOP_S)


@dataclass
class Sent:
    """Stamps of corrections, and χ² of each in the plane."""

    stamps_ns: list[int]
    chi2: list[float]


def drive(pipeline: Pipeline, session: Session, messages: Messages) -> Sent:
    sent = Sent([], [])
    for node, message in messages:
        pipeline.push(node, message)
        for output in pipeline.advance(message.stamp_ns + to_ns(0.02)):
            if output.topic is topics.CORRECTION:
                assert isinstance(output.message, PoseEstimate)
                said = output.message
                truth = session.map_from_base("r1", said.stamp_ns)
                error = said.pose.difference(truth)[PLANE]
                spread = said.covariance[np.ix_(PLANE, PLANE)]
                sent.stamps_ns.append(said.stamp_ns)
                sent.chi2.append(float(error @ np.linalg.solve(spread, error)))
    return sent


def split(session: Session) -> tuple[Messages, Messages]:
    """What came before fusion was killed, and what comes afterwards."""
    stop_ns = EPOCH_NS + to_ns(STOP_S)
    before = [item for item in session.messages if item[1].stamp_ns < stop_ns]
    return tuple(before), tuple(session.messages[len(before) :])


@pytest.fixture(scope="module")
def killed(charuco: Session) -> Pipeline:
    """A live map when fusion is killed."""
    pipeline = Pipeline(charuco.inputs, solver=SlowSolver(charuco.inputs))
    drive(pipeline, charuco, split(charuco)[0])
    return pipeline


def again(session: Session, solution: Solved | None, *, calls: int = NEVER) -> Pipeline:
    """Fusion started again, whose solver takes so many turns to answer."""
    solver = SlowSolver(session.inputs, calls=calls)
    pipeline = Pipeline(session.inputs, is_live=False, solver=solver)
    before, _ = split(session)
    replayed(pipeline, before)
    assert pipeline.resumed(solution=solution) == (solution is not None)
    return pipeline


def stored(inputs: Inputs, folder: Path, killed: Pipeline) -> SolutionFile:
    file = SolutionFile(folder, inputs)
    file.keep(killed)
    file.write()
    return SolutionFile(folder, inputs)


def test_corrections_go_on_before_anything_is_solved(
    charuco: Session, killed: Pipeline, tmp_path: Path
) -> None:
    _, after = split(charuco)
    assert not drive(again(charuco, None), charuco, after).stamps_ns
    solution = stored(charuco.inputs, tmp_path, killed).load(killed.map_id, NOW_NS)
    pipeline = again(charuco, solution)
    sent = drive(pipeline, charuco, after)
    goes_on = drive(killed_again(charuco), charuco, after)
    # As though nothing had happened: from the first sighting on.
    assert sent.stamps_ns[0] == goes_on.stamps_ns[0]
    assert len(sent.stamps_ns) > 10
    assert np.mean(sent.chi2) < 2 * len(PLANE)
    assert pipeline.located_count == killed.located_count


def killed_again(session: Session) -> Pipeline:
    """The live map once more, whose solver answers no more from when fusion was killed."""
    solver = SlowSolver(session.inputs)
    pipeline = Pipeline(session.inputs, solver=solver)
    drive(pipeline, session, split(session)[0])
    solver._calls = NEVER
    return pipeline


def test_nothing_counts_twice(charuco: Session, killed: Pipeline, tmp_path: Path) -> None:
    solution = stored(charuco.inputs, tmp_path, killed).load(killed.map_id, NOW_NS)
    assert solution is not None
    estimator, before = again(charuco, solution)._estimator, killed._estimator
    for name, camera in before.cameras().items():
        here = estimator.cameras()[name]
        # At most what the filter knew that was killed, up to the creep of no time at all.
        least = np.linalg.eigvalsh(here.covariance - camera.covariance).min()
        assert least > -1e-6 * np.trace(camera.covariance)
    robot, was = estimator.robot("r1"), before.robot("r1")
    assert robot is not None
    assert was is not None
    assert np.trace(robot.covariance) >= 0.999 * np.trace(was.covariance)


def test_only_sightings_after_those_of_the_solution_are_used(
    charuco: Session, killed: Pipeline
) -> None:
    solution = killed.reports.solution
    assert solution is not None
    late = replace(solution, until_ns=EPOCH_NS + to_ns(STOP_S))
    some, none = (again(charuco, each)._estimator.robot("r1") for each in (solution, late))
    assert some is not None
    assert none is not None
    assert np.trace(none.covariance) > np.trace(some.covariance)


def test_solver_s_answer_takes_over(
    charuco: Session, charuco_results: Results, killed: Pipeline
) -> None:
    _, after = split(charuco)
    pipeline = again(charuco, killed.reports.solution, calls=100)
    sent = drive(pipeline, charuco, after)
    assert np.mean(sent.chi2) < 2 * len(PLANE)
    pipeline.finish()
    while not pipeline.reports.is_answered:
        pipeline.advance()
    assert_same_places(pipeline.results().network, charuco_results.network)


def test_cameras_may_have_crept_while_fusion_was_away(
    charuco: Session, killed: Pipeline, tmp_path: Path
) -> None:
    file, week_ns = stored(charuco.inputs, tmp_path, killed), to_ns(7 * 86400.0)
    times_ns = NOW_NS, NOW_NS + week_ns
    soon, later = (
        again(charuco, file.load(killed.map_id, at))._estimator.cameras() for at in times_ns
    )
    config = charuco.inputs.site.cameras["c1"]
    assert config.creep_translation > 0
    added = np.diagonal(later["c1"].covariance - soon["c1"].covariance)[:3]
    np.testing.assert_allclose(added, 7 * config.creep_translation**2, rtol=0.5)


def test_solution_that_odometry_does_not_reach_is_not_used(
    charuco: Session, killed: Pipeline
) -> None:
    solution = killed.reports.solution
    assert solution is not None
    pipeline = Pipeline(charuco.inputs, is_live=False, solver=SlowSolver(charuco.inputs))
    replayed(pipeline, split(charuco)[0][:60])
    assert not pipeline.resumed(solution=solution)


def test_file_says_the_same(charuco: Session, killed: Pipeline, tmp_path: Path) -> None:
    solution = killed.reports.solution
    found = stored(charuco.inputs, tmp_path, killed).load(killed.map_id, NOW_NS)
    assert solution is not None
    assert found is not None
    assert found.until_ns == solution.until_ns
    assert found.shares == solution.shares
    assert found.located == solution.located
    known, here = solution.known, found.known
    np.testing.assert_allclose(here.known.covariance, known.known.covariance, atol=1e-10)
    assert np.array_equal(known.known.mean, here.known.mean)
    assert here.stamps_ns == known.stamps_ns


def test_what_does_not_fit_is_not_used(
    charuco: Session, killed: Pipeline, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    inputs = charuco.inputs
    file = stored(inputs, tmp_path, killed)
    assert file.load(None, NOW_NS) is None  # of another map
    fusion = msgspec.structs.replace(inputs.site.fusion, late=0.123)
    site = msgspec.structs.replace(inputs.site, fusion=fusion)
    with caplog.at_level(logging.INFO):
        assert (
            SolutionFile(tmp_path, replace(inputs, site=site)).load(killed.map_id, NOW_NS) is None
        )
        assert "the site or the program has changed" in caplog.text
        path = tmp_path / SOLUTION
        whole = path.read_bytes()
        path.write_bytes(whole[:-1])
        assert file.load(killed.map_id, NOW_NS) is None
        assert "it is damaged" in caplog.text
        body = msgspec.msgpack.encode({"inputs": b"of an older version"})
        save_checked(path, whole[:21], len(body).to_bytes(8, "little"), body)
        assert file.load(killed.map_id, NOW_NS) is None
        assert "missing required field" in caplog.text
    path.unlink()
    assert file.load(killed.map_id, NOW_NS) is None


def test_what_is_forgotten_is_not_written(
    charuco: Session, killed: Pipeline, tmp_path: Path
) -> None:
    file = SolutionFile(tmp_path, charuco.inputs)
    file.keep(killed)
    file.forget()
    file.write()
    assert not (tmp_path / SOLUTION).exists()


def test_nobody_waits_for_the_disk_and_the_last_solution_is_written(
    charuco: Session, killed: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, writing, goes_on = SolutionFile(tmp_path, charuco.inputs), Event(), Event()
    pulse, stopping = Watchdog().pulse("keeps", within_s=PATIENCE_S), Event()

    def slow(*arguments: Any, **options: Any) -> None:
        writing.set()
        assert goes_on.wait(PATIENCE_S)
        save_checked(*arguments, **options)

    monkeypatch.setattr("trigpoint.fusion.solution_file.save_checked", slow)
    thread = Thread(target=file.run, args=(pulse, stopping))
    thread.start()
    file.keep(killed)
    assert writing.wait(PATIENCE_S)
    later = again(charuco, killed.reports.solution, calls=1)
    later.finish()
    while not later.reports.is_answered:
        later.advance()
    file.keep(later)
    assert not (tmp_path / SOLUTION).exists()
    stopping.set()
    goes_on.set()
    thread.join(PATIENCE_S)
    found, solution = file.load(later.map_id, NOW_NS), later.reports.solution
    assert found is not None
    assert solution is not None
    assert np.array_equal(found.known.known.mean, solution.known.known.mean)
