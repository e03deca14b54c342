"""Two robots that carry one target, in the lab of the study."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.session import composed_session
from benchmarks.study.judge import GROSS
from benchmarks.study.session import StudySession, simulated_session, worked_out
from trigpoint.fusion.intake.robot_identity import RobotIdentification
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.tools.calibrate.work import fed, task_of
from trigpoint.tools.simulation.session import EPOCH_NS


@pytest.fixture(scope="module")
def session() -> StudySession:
    return simulated_session("robots_alike", 0)


@pytest.fixture(scope="module")
def pipeline(session: StudySession) -> Pipeline:
    return worked_out(session)


def test_robots_that_drove_alike_are_told_apart_by_where_they_stood(pipeline: Pipeline) -> None:
    # r1 passes c2 as r2 passes c3, straight on and equally fast; later r2 comes to c2 alone.
    used = pipeline.results().network.cameras["c2"]
    assert used.sightings == 113
    assert used.rejected == 0


def test_robots_that_drove_alike_are_told_apart_by_what_others_saw_of_them(
    pipeline: Pipeline,
) -> None:
    # c3 and c6 see r2 once each, while another camera sees r1 drive just as straight.
    network = pipeline.results().network
    assert network.located == ["c1", "c2", "c3", "c4", "c5", "c6"]
    assert pipeline.left_out == {}
    assert pipeline.last_problem == ""


def test_no_sighting_is_taken_for_another_robots(session: StudySession, pipeline: Pipeline) -> None:
    results = pipeline.results()
    truth = session.simulated.cameras
    for index, name in enumerate(results.network.located):
        record = results.network.cameras[name].map_from_camera
        assert record is not None
        error = record.pose.difference(truth[name])
        rows = slice(6 * index, 6 * index + 6)
        own = results.covariance[rows, rows]
        assert np.sqrt(error @ np.linalg.solve(own, error) / 6) < GROSS


def test_few_more_sightings_of_located_cameras_are_no_reason_to_explain_all_anew(
    pipeline: Pipeline,
) -> None:
    data, estimator = pipeline._data, pipeline._estimator  # pyright: ignore[reportPrivateUsage]
    seen = next(e.observation for e in data.entries if e.observation.camera == "c1")
    faces = tuple({str(robot): view for robot in ("r1", "r2")} for view in seen.views)
    for count, is_told in ((1, False), (len(data.entries) // 10, True)):
        identification = RobotIdentification(data)
        for _ in range(count):
            identification.add("c1", seen.stamp_ns, faces)
            identification.ready(is_end=True)  # one picture alone tells nothing
        assert identification.untold == count
        assert len(identification.by_place(estimator, is_end=True)) == count * is_told
        assert identification.untold == count * (not is_told)


@pytest.mark.long
def test_a_face_that_two_robots_explain_is_not_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For two seconds the way of r1, which is out of sight, leads to where a face of r2 is seen."""
    drawn = composed_session("everything", 82)
    camera = next(each for each in drawn.cameras if each.name == "c7")
    alone = replace(drawn, cameras=[camera], pictures={"c7": drawn.pictures["c7"]})
    task = task_of(write_composition(alone, tmp_path))
    told: list[Observation] = []
    ready = RobotIdentification.ready

    def kept(self: RobotIdentification, *, is_end: bool = False) -> list[Observation]:
        told.extend(ready(self, is_end=is_end))
        return []

    monkeypatch.setattr(RobotIdentification, "ready", kept)
    fed(task.messages(), task.inputs, source=task.path).finish()
    true = {
        (EPOCH_NS + picture.stamp_ns(camera.time_offset_s), face.robot)
        for picture in alone.pictures["c7"]
        for face in picture.faces
    }
    assert len(told) > 1000
    assert all((o.stamp_ns, o.robot) in true for o in told)
