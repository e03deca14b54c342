"""What is wrong, late, failed or honest in what `calibrate` says of a drawn session."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.compositions.recipe import Recipe
from benchmarks.compositions.session import Composition, session_of
from benchmarks.study.report import line_of, write_compositions
from benchmarks.study.result import Outcome, Result, Verdict
from benchmarks.study.store import Store
from benchmarks.study.work import composition_case, found_in
from trigpoint.geometry import Pose
from trigpoint.map.network import (
    AlternativeRecord,
    CameraRecord,
    Network,
    PoseRecord,
    Statistics,
    save_network,
)

_SIGMA = 0.01


@pytest.fixture(scope="module")
def session() -> Composition:
    return session_of(Recipe("loop-alike", 2, cameras=3))


def _network(
    folder: Path,
    session: Composition,
    errors: dict[str, np.ndarray],
    open_at: dict[str, Pose] | None = None,
) -> None:
    """A network in which some cameras are located, off by errors (6,); others are left open."""
    covariance, cameras = _SIGMA**2 * np.eye(6), dict[str, CameraRecord]()
    told = tuple(covariance.ravel().tolist())
    for name, place in session.last_places().items():
        there = (open_at or {}).get(name)
        named = () if there is None else (AlternativeRecord(PoseRecord.of(there), told, 0.4),)
        cameras[name] = CameraRecord("undetermined", alternatives=named)
        if name in errors:
            found = PoseRecord.of(place.disturbed(errors[name]))
            cameras[name] = CameraRecord("located", map_from_camera=found, covariance=told)
    network = Network("lab", "", "smoother", cameras, {}, Statistics(1.0, 3))
    joint = _SIGMA**2 * np.eye(6 * len(errors))
    save_network(folder, network, covariance=joint, trajectories={})


def _judged(folder: Path, session: Composition, errors: dict[str, np.ndarray]) -> Result:
    _network(folder, session, errors)
    return _found(folder, session)


def _found(folder: Path, session: Composition, status: int = 0, said: str = "") -> Result:
    """The result of what `calibrate` would have left in a folder."""
    case = composition_case(session)
    return replace(case, work=lambda: (1.0, found_in(folder, status, said))).result()


def test_errors_of_a_sigma_are_honest_and_right(tmp_path: Path, session: Composition) -> None:
    score = _judged(tmp_path, session, {"c1": np.full(6, _SIGMA), "c3": np.full(6, -_SIGMA)})
    assert score.honesty == pytest.approx(1.0, rel=1e-3)
    assert not score.is_bad
    assert [camera.is_located for camera in score.cameras] == [True, False, True]


def test_a_camera_many_of_its_sigmas_off_is_wrong(tmp_path: Path, session: Composition) -> None:
    off = np.array([9 * _SIGMA, 0, 0, 0, 0, 0])
    score = _judged(tmp_path, session, {"c1": np.zeros(6), "c2": off})
    assert [camera.name for camera in score.those(Verdict.WRONG)] == ["c2"]
    assert score.honesty is None
    assert "c2 wrong by 9 cm (9 sigmas)" in line_of(score)


def test_a_camera_without_a_pose_that_names_the_true_place_has_it_among_its_alternatives(
    tmp_path: Path, session: Composition
) -> None:
    place = session.last_places()["c1"]
    shifted = {
        name: Pose(place.rotation, place.translation + shift)
        for name, shift in (("c1", 0.0), ("c2", 3.0))
    }
    _network(tmp_path, session, {}, shifted)
    score = _found(tmp_path, session)
    assert [camera.among for camera in score.cameras] == [True, False, None]


def test_a_session_without_a_network_has_failed_and_says_why(
    tmp_path: Path, session: Composition
) -> None:
    score = _found(tmp_path, session, 1, "Traceback\nKeyError: 'c6'\n")
    assert score.outcome is Outcome.FAILED
    assert score.why == "exit 1: KeyError: 'c6'"


def test_scores_are_kept_and_a_torn_line_is_passed_over(
    tmp_path: Path, session: Composition
) -> None:
    score = _judged(tmp_path, session, {"c1": np.zeros(6)})
    store = Store(tmp_path / "scores")
    store.add(score)
    with (tmp_path / "scores" / "loop-alike.jsonl").open("ab") as file:
        file.write(b'{"sources": "x", "sc')
    assert store.kept("loop-alike") == [score]


def test_the_page_counts_and_names_what_is_wrong(tmp_path: Path, session: Composition) -> None:
    off = np.array([0.5, 0, 0, 0, 0, 0])
    scores = [_judged(tmp_path, session, {"c1": np.zeros(6), "c2": off})]
    text = write_compositions({"loop-alike": scores}, tmp_path).read_text()
    assert "- loop-alike 2 smoother: 2/3 located" in text
    [row] = [line for line in text.splitlines() if "known faces" in line]
    assert "**1**" in row
