"""Sessions of the study: what is wrong in them, what an oracle knows, and what is kept of them."""

import signal
import tempfile
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from benchmarks.study.command import app
from benchmarks.study.judge import judged
from benchmarks.study.oracle import known_to_oracle
from benchmarks.study.report import (
    BEGIN,
    END,
    count_of,
    line_of,
    ratio_of,
    write_compositions,
    write_situations,
)
from benchmarks.study.result import Camera, Outcome, Result, Verdict
from benchmarks.study.session import StudySession, simulated_session
from benchmarks.study.situations import SITUATIONS
from benchmarks.study.store import Store, bounded, jobs_of, open_jobs, run
from benchmarks.study.work import Job, situation_case
from benchmarks.timing import ended
from trigpoint.fusion.solver.levenberg_marquardt import linearise, solve
from trigpoint.tools.networks.cramer_rao import oracle_problem

RESULT = Result(
    session="drive",
    seed=3,
    seconds=2.0,
    cameras=[Camera("c1", Verdict.RIGHT)],
    honesty=1.0,
    efficiency=1.21,
    distance=0.01,
    distance_bound=0.01,
)


@pytest.fixture(scope="module")
def session() -> StudySession:
    return simulated_session("one_picture", 1)


def test_the_bound_is_the_smoothers_covariance_at_the_truth(session: StudySession) -> None:
    assembled = oracle_problem(*known_to_oracle(session.inputs, session.simulated))
    at_truth = solve(assembled.problem, assembled.start, most_iterations=0)
    columns = np.concatenate(list(at_truth.reduced.layout.pose.values()))
    own = at_truth.reduced.covariance()[np.ix_(columns, columns)]
    np.testing.assert_allclose(session.bound.covariance, own, rtol=1e-9)


def test_the_truth_costs_what_the_noise_is_worth(session: StudySession) -> None:
    """χ² at the truth is that of as many normal draws as there are residuals."""
    assembled = oracle_problem(*known_to_oracle(session.inputs, session.simulated))
    corners = sum(int((batch.weights > 0).sum()) for batch in assembled.problem.batches)
    steps = sum(len(chain) - 1 for chain in assembled.problem.chains.values())
    count = 2 * corners + 3 * steps
    cost = linearise(assembled.problem, assembled.start).cost
    assert abs(cost - count) < 5 * np.sqrt(2 * count)


def test_the_smoothers_errors_are_of_the_bounds_size(session: StudySession) -> None:
    measure = situation_case(session).result()
    assert [c.name for c in measure.cameras] == sorted(session.simulated.cameras)
    assert all(camera.verdict is Verdict.RIGHT for camera in measure.cameras)
    assert measure.efficiency is not None
    assert 0.5 < measure.efficiency < 2.0  # 36 degrees of freedom: six sigmas


def test_a_network_of_one_camera_has_no_distances(session: StudySession) -> None:
    case = situation_case(session)
    _, found = case.work()
    assert not isinstance(found, str)
    network, covariance = found
    first = network.located[0]
    alone = replace(network, cameras={first: network.cameras[first]})
    measure = judged(case.blank, case.truth, alone, covariance[:6, :6])
    assert measure.efficiency is not None
    assert (measure.distance, measure.distance_bound) == (None, None)


def test_a_session_is_the_same_for_the_same_seed_and_differs_for_another() -> None:
    first, again, other = (simulated_session("one_picture", seed) for seed in (1, 1, 2))
    assert [repr(m) for m in first.messages[-50:]] == [repr(m) for m in again.messages[-50:]]
    last = max(stamp_ns for _, stamp_ns in first.simulated.sighted)
    end_ns = np.array([last])
    truths = [s.simulated.map_from_base("r1", end_ns) for s in (first, other)]
    assert np.linalg.norm(truths[0].difference(truths[1])) > 1e-6


@pytest.mark.parametrize("name", SITUATIONS)
def test_every_situation_has_a_world(name: str) -> None:
    from benchmarks.study.worlds import world_of

    situation = SITUATIONS[name]
    assert world_of(situation.world, seed=0, target=situation.target).duration_s > 30


def test_a_session_over_its_limit_is_late_and_one_that_ends_badly_has_failed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    late = bounded(Job("drive-everything", 1), 0.5)
    assert late.outcome is Outcome.LATE
    assert late.is_bad
    assert not list(tmp_path.iterdir())
    assert late.is_alike
    assert {camera.verdict for camera in late.cameras} == {Verdict.UNKNOWN}
    failed = bounded(Job("drive", 1, "none"), 60.0)
    assert failed.outcome is Outcome.FAILED
    assert failed.is_bad
    assert "none" in failed.why


_LINE = msgspec.json.encode(RESULT) + b"\n"


@pytest.mark.parametrize(
    ("status", "told", "outcome"),
    [
        (0, _LINE * 2, Outcome.DONE),
        (0, _LINE, Outcome.FAILED),
        (0, _LINE + _LINE[:40], Outcome.FAILED),
        (0, _LINE * 2 + b"a library's word\n", Outcome.FAILED),
        (0, b"\xff\n" + _LINE * 2, Outcome.FAILED),
        (0, _LINE.replace(b"drive", b"\xff") * 2, Outcome.FAILED),
        (1, _LINE, Outcome.FAILED),
        (-signal.SIGSEGV, _LINE, Outcome.FAILED),
        (-signal.SIGABRT, _LINE, Outcome.FAILED),
        (-signal.SIGPROF, _LINE + _LINE[:40], Outcome.LATE),
        (-signal.SIGKILL, _LINE, Outcome.STOPPED),
        (-signal.SIGTERM, b"", Outcome.STOPPED),
        (None, _LINE, Outcome.STOPPED),
    ],
)
def test_what_a_process_told_and_its_end_decide_what_is_kept(
    status: int | None,
    told: bytes,
    outcome: Outcome,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setattr("benchmarks.study.store.ended", lambda *_, **__: (status, told, ""))
    store, jobs = Store(tmp_path), [Job("drive", 3)]
    [result] = run(store, jobs, processes=1, limit_s=1.0)
    assert result.outcome is outcome
    assert result.cameras == (RESULT.cameras if told.startswith(_LINE) else [])
    assert result.is_bad is (outcome is not Outcome.DONE)
    assert open_jobs(store, jobs) == (jobs if outcome is Outcome.STOPPED else [])
    assert (outcome in line_of(result)) is (outcome is not Outcome.DONE)


def test_a_program_over_its_time_by_the_clock_has_no_status() -> None:
    assert ended("asyncio", environment={}, most_s=0.01)[0] is None


def test_only_sessions_that_are_not_kept_yet_are_open(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.add(RESULT)
    jobs = jobs_of(["drive"], range(5), ("smoother", "ekf"))
    assert len(jobs) == 10
    assert set(jobs) - set(open_jobs(store, jobs)) == {Job("drive", 3)}


def test_a_torn_line_and_lines_of_other_sources_do_not_count(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.add(RESULT)
    path = tmp_path / "drive.jsonl"
    line = path.read_bytes()
    path.write_bytes(line + line[:40])
    assert store.kept("drive") == [RESULT]
    path.write_bytes(line.replace(b'"sources":"', b'"sources":"x'))
    assert store.kept("drive") == []


def test_a_summary_is_the_root_of_the_mean_square() -> None:
    measures = [
        replace(RESULT, efficiency=1.0, cameras=_cameras(Verdict.WRONG)),
        replace(RESULT, efficiency=1.42),
        replace(RESULT, efficiency=None, cameras=_cameras(Verdict.MISSED, Verdict.LEFT_OPEN)),
    ]
    assert ratio_of(measure.efficiency for measure in measures).value == pytest.approx(1.1)
    verdicts = (Verdict.WRONG, Verdict.MISSED, Verdict.LEFT_OPEN)
    assert [count_of(measures, verdict) for verdict in verdicts] == [1] * 3
    assert count_of(measures, *verdicts) == 2


def test_the_report_shows_what_misses_its_goal(tmp_path: Path) -> None:
    good = [replace(RESULT, seed=s, efficiency=1.0 + 0.01 * s) for s in range(3)]
    bad = [replace(RESULT, seed=s, session="wild", efficiency=4.0 + 0.01 * s) for s in range(3)]
    page = tmp_path / "accuracy.md"
    page.write_text(f"Before.\n{BEGIN}\nold\n{END}\nBehind.\n", encoding="utf-8")
    path = write_situations({"drive": good, "wild": bad}, tmp_path)
    text = path.read_text(encoding="utf-8")
    assert (text.startswith("Before."), "old" in text, text.endswith("Behind.\n")) == (1, 0, 1)
    lines = {line.split(" | ")[0]: line for line in text.splitlines() if line.startswith("| ")}
    assert "**" not in lines["| " + SITUATIONS["drive"].title]
    assert "**2.0" in lines["| " + SITUATIONS["wild"].title]


def test_sessions_without_a_network_are_counted_and_averaged_over_nothing(tmp_path: Path) -> None:
    done = [replace(RESULT, seed=seed) for seed in range(2)]
    failed = Result("drive", 4, 0.0, outcome=Outcome.FAILED)
    late = Result("wild", 5, 120.0, outcome=Outcome.LATE)
    text = write_situations({"drive": [*done, failed], "wild": [late]}, tmp_path).read_text("utf-8")
    cells = {line.split(" | ")[0]: line.split(" | ") for line in text.splitlines()}
    drive, wild = (cells["| " + SITUATIONS[name].title] for name in ("drive", "wild"))
    assert (drive[1], drive[4], drive[7]) == ("3, 1 without a network", "1.00, 1.00", "2.00 |")
    assert (wild[1], wild[4], wild[7]) == ("1, 1 without a network", "–", "– |")
    assert "a ratio of 1.000" in text
    text = write_situations({"drive": [failed]}, tmp_path).read_text("utf-8")
    assert "## Distances" not in text
    path = write_compositions({"composition": [*done, failed], "space": [late]}, tmp_path)
    ends = [line.split(" | ")[-1] for line in path.read_text("utf-8").splitlines()]
    assert "2.0, 2.0 |" in ends
    assert "– |" in ends


def _cameras(*verdicts: Verdict) -> list[Camera]:
    return [Camera(f"c{number}", verdict) for number, verdict in enumerate(verdicts)]


def test_a_report_without_the_smoother_writes_nothing(tmp_path: Path) -> None:
    Store(tmp_path).add(replace(RESULT, estimator="ekf"))
    docs = tmp_path / "docs"
    result = CliRunner().invoke(app, ["report", "--folder", str(tmp_path), "--docs", str(docs)])
    assert result.exit_code == 2
    assert not docs.exists()
