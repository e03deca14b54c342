"""The estimator on a bus: what it takes, what it says, what it answers, and its second life."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.builders import eventually, largest_file
from support.fusion.drives import EPOCH_NS, Session
from support.fusion.networks import assert_same_place
from support.fusion.running_node import running

from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import OperationError
from trigpoint.bus.bus import Subscription
from trigpoint.contract import cdr, topics
from trigpoint.contract.clock_doubt import CLOCK_OFF_BY
from trigpoint.contract.correction import decode_mark
from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    Message,
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Sightings,
)
from trigpoint.contract.nudge import NUDGED, Nudge
from trigpoint.fusion.checkpoint import Checkpoint, read_checkpoint
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.intake.standstills import MOST_ALIKE
from trigpoint.fusion.live import coverage_thread
from trigpoint.fusion.model.odometry import MOST_STANDING
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.map.network import decode_network, load_network


def received(subscription: Subscription) -> list[tuple[str, Message, bytes]]:
    found = []
    while (sample := subscription.take(0.0)) is not None:
        topic = topics.topic_of(sample.key)
        assert topic is not None
        assert sample.encoding == topic.encoding
        message = cdr.decode(topic.type_name, sample.payload)
        found.append((sample.key, message, sample.attachment))
    return found


def test_drive_over_the_bus_ends_in_the_network_of_the_session(
    charuco: Session, charuco_results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coverage_thread, "PERIOD_S", 1.0)
    with running(charuco.inputs, tmp_path) as run:
        wanted = (
            topics.CAMERA_POSE,
            topics.ROBOT_POSE,
            topics.CORRECTION,
            topics.TF,
            topics.COVERAGE,
        )
        heard = {topic.name: run.listen(topic) for topic in wanted}
        grids = run.listen(topics.COVERAGE_GRID)
        run.feed(charuco.messages)
        odometry = sum(isinstance(m, Odometry) for _, m in charuco.messages)
        assert eventually(lambda: heard["robot_pose"].depth == odometry)
        covered: set[str] = set()
        coverage = heard.pop("coverage")
        assert eventually(
            lambda: bool(covered.update(key for key, *_ in received(coverage)) or len(covered) == 3)
        )
        said = {name: received(subscription) for name, subscription in heard.items()}
        map_id = run.ask("fusion/map")["map_id"]
        assert eventually(lambda: grids.depth > 0)
        key, grid, _ = received(grids)[-1]
        assert run.node.health.total("rejected") == 0
        assert eventually(lambda: run.node.health.report().values["cameras_located"] == "3")
        values = run.node.health.report().values
        assert values["cameras_undetermined"] == "0"
        assert 0 < float(values["worst_sigma_m"]) < 0.1
        told = values["cameras"]
        assert re.fullmatch(r"c1 <0.1 cm, c2 ±[0-9.]+ cm, c3 ±[0-9.]+ cm", told)
        answered = run.ask("fusion/network")
    run.fusion.finish()
    network = load_network(tmp_path)
    assert {camera["status"] for camera in answered["cameras"].values()} == {"located"}
    assert network.map_id == map_id == answered["map_id"] == charuco_results.network.map_id
    for name, record in charuco_results.network.cameras.items():
        assert_same_place(network.cameras[name], record)
    assert {key for key, *_ in said["camera_pose"]} == {f"lab/camera/c{i}/pose" for i in (1, 2, 3)}
    assert covered == {f"lab/coverage/c{i}" for i in (1, 2, 3)}
    assert isinstance(grid, OccupancyGrid)
    assert (key, grid.frame_id) == ("lab/coverage", "map")
    assert np.any((grid.values >= 0) & (grid.values < 99))
    assert len(said["tf"]) > 100
    marks = [decode_mark(attachment) for *_, attachment in said["correction"]]
    assert {str(mark.map_id) for mark in marks} == {map_id}
    first = marks[0].sequence
    assert [mark.sequence for mark in marks] == list(range(first, first + len(marks)))
    with np.load(tmp_path / "covariance.npz") as archive:
        assert archive["covariance"].shape == (18, 18)
        assert archive["cameras"].tolist() == ["c1", "c2", "c3"]
    assert (tmp_path / "r1.tum").read_text().count("\n") == odometry


def test_killed_fusion_resumes_its_map_and_ends_where_it_would_have(
    charuco: Session, charuco_results: Results, tmp_path: Path
) -> None:
    middle = 2 * len(charuco.messages) // 3
    first, second = tmp_path / "first", tmp_path / "second"
    with running(charuco.inputs, first) as run:
        corrections = run.listen(topics.CORRECTION)
        run.feed(charuco.messages[:middle])
        before = run.ask("fusion/map")
        assert eventually(lambda: corrections.depth > 0)
        run.keep(first / "checkpoint.bin")
        last = max(decode_mark(mark).sequence for *_, mark in received(corrections))
        # What a killed process leaves is what is on the disk now.
        second.mkdir()
        shutil.copy(first / "checkpoint.bin", second)
    with running(charuco.inputs, second) as run:
        assert run.ask("fusion/map") == before
        corrections = run.listen(topics.CORRECTION)
        run.feed(charuco.messages[middle:])
        assert eventually(lambda: corrections.depth > 0)
        marks = [decode_mark(mark) for *_, mark in received(corrections)]
    run.fusion.finish()
    assert {str(mark.map_id) for mark in marks} == {before["map_id"]}
    assert min(mark.sequence for mark in marks) > last
    network = load_network(second)
    assert network.map_id == before["map_id"]
    for name, record in charuco_results.network.cameras.items():
        assert network.cameras[name].sightings == record.sightings
        assert_same_place(network.cameras[name], record)


def test_reset_begins_a_new_map(charuco: Session, tmp_path: Path) -> None:
    with running(charuco.inputs, tmp_path) as run:
        run.feed(charuco.messages[:150])
        first = run.ask("fusion/map")
        assert run.ask("fusion/reset") == {}
        [reply] = run.bus.query("lab/fusion/map")
        assert "no map yet" in reply.error
        run.feed(charuco.messages[150:200])
        second = run.ask("fusion/map")
        assert run.ask("fusion/network")["map_id"] == second["map_id"]
    assert first != second
    assert decode_network((tmp_path / "network.json").read_bytes()).map_id == second["map_id"]


def test_clock_is_answered(charuco: Session, tmp_path: Path) -> None:
    with running(charuco.inputs, tmp_path) as run:
        assert run.ask("clock") == {"now_ns": EPOCH_NS}


def test_map_that_is_not_there_yet_is_refused_in_words(charuco: Session, tmp_path: Path) -> None:
    with running(charuco.inputs, tmp_path) as run:
        [reply] = run.bus.query("lab/fusion/map")
    assert "no odometry of the first robot" in reply.error


@pytest.mark.parametrize("payload", [b"", b"garbage", b"\x00\x01\x00\x00" + b"\xff" * 60])
def test_garbage_is_rejected_and_its_sender_named(
    charuco: Session, tmp_path: Path, payload: bytes
) -> None:
    with running(charuco.inputs, tmp_path) as run:
        for topic, name in (
            (topics.ODOMETRY, "r1"),
            (topics.SIGHTINGS, "c1"),
            (topics.CAMERA_INFO, "c1"),
        ):
            run.bus.publisher(topic, topic.key("lab", name)).put(payload)
        assert eventually(lambda: run.node.health.total("rejected") == 3)
        assert f"from session {run.bus.identity}" in run.node.health.last_error
        run.feed(charuco.messages[:60])  # and it goes on
        assert run.ask("fusion/map")["map_id"]


def test_sample_of_another_type_is_rejected(charuco: Session, tmp_path: Path) -> None:
    _, odometry = charuco.messages[0]
    with running(charuco.inputs, tmp_path) as run:
        key = topics.ODOMETRY.key("lab", "r1")
        run.bus.publisher(topics.CORRECTION, key).put(cdr.encode(odometry))
        assert eventually(lambda: run.node.health.total("rejected") == 1)
        assert "its encoding is" in run.node.health.last_error


def test_what_does_not_fit_is_in_the_diagnostics(charuco: Session, tmp_path: Path) -> None:
    strange = Sightings(EPOCH_NS, "c1/optical", 320, 240, ())
    with running(charuco.inputs, tmp_path) as run:
        run.feed((("c1", strange), *charuco.messages[:10]))
        assert eventually(lambda: run.node.health.total("left_out.wrong_size") == 1)
        assert "320 × 240" in run.node.health.last_error


def test_camera_that_said_that_it_was_nudged_is_in_the_diagnostics_also_after_a_kill(
    charuco: Session, tmp_path: Path
) -> None:
    """What it says of its clock in the same message is of its moment."""
    nudge = Nudge("c2", EPOCH_NS + 10**9, EPOCH_NS + 2 * 10**9)
    values = {NUDGED: nudge.value, CLOCK_OFF_BY: "+0.300"}
    status = DiagnosticStatus(0, "edge/c2", "", "host", values)
    told = Diagnostics(nudge.since_ns, (status,))
    with running(charuco.inputs, tmp_path) as run:
        run.feed(charuco.messages[:60])
        key = topics.DIAGNOSTICS.key("lab")
        run.bus.publisher(topics.DIAGNOSTICS, key).put(cdr.encode(told))
        assert eventually(lambda: "input: doubted camera c2" in run.node.health.held)
        assert run.node.health.total("left_out.camera_nudged") == 1
        assert "its clock is 0.300 s ahead" in run.node.health.held["input: doubted camera c2"]
        run.keep(tmp_path / "checkpoint.bin")
    with running(charuco.inputs, tmp_path) as run:
        run.ask("fusion/map")
        assert eventually(lambda: "input: doubted camera c2" in run.node.health.held)
        assert "clock" not in run.node.health.held["input: doubted camera c2"]


def test_announced_lenses_are_used(charuco: Session, tmp_path: Path) -> None:
    inputs = Inputs(charuco.inputs.site, charuco.inputs.targets)
    infos = tuple(
        (n, CameraInfo(EPOCH_NS, f"{n}/optical", c.lens)) for n, c in charuco.plan.cameras.items()
    )
    with running(inputs, tmp_path) as run:
        run.feed((*infos, *charuco.messages[:200]))
        network = run.ask("fusion/network")
    assert network["cameras"]["c1"]["status"] == "located"
    assert network["cameras"]["c1"]["intrinsics"]["k"][0] == charuco.plan.cameras["c1"].lens.fx


def test_fusion_goes_on_where_the_disk_is_full_and_says_so(
    charuco: Session, tmp_path: Path
) -> None:
    with running(charuco.inputs, tmp_path) as fusion:
        with largest_file(1_000):
            fusion.feed(charuco.messages[:300])
            fusion.clock.advance(1.0)  # after which it writes
            fusion.feed(charuco.messages[300:310])
            assert eventually(lambda: fusion.node.health.lost("checkpoint") > 0)
        assert eventually(lambda: "cannot be written now" in fusion.node.health.last_error)
        assert fusion.ask("fusion/map")["map_id"]


def test_checkpoint_of_another_site_is_refused(charuco: Session, tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "checkpoint.bin", ManualClock())
    checkpoint.write("hall/robot/r1/odom", cdr.encode(charuco.messages[0][1]))
    checkpoint.close()
    with (
        pytest.raises(OperationError, match="another site"),
        running(charuco.inputs, tmp_path) as fusion,
    ):
        fusion.node.wait()  # until it has read it


def test_poses_that_are_said_are_those_of_the_map(charuco: Session, tmp_path: Path) -> None:
    with running(charuco.inputs, tmp_path) as run:
        heard = run.listen(topics.ROBOT_POSE)
        run.feed(charuco.messages[:100])
        assert eventually(lambda: heard.depth > 0)
        poses = [message for _, message, _ in received(heard)]
    assert poses
    for message in poses:
        assert isinstance(message, PoseEstimate)
        assert message.frame_id == "map"
        true = charuco.map_from_base("r1", message.stamp_ns)
        # Two seconds after the start: centimetres.
        assert np.abs(message.pose.difference(true)).max() < 0.05


def test_checkpoint_of_a_standstill_is_bounded_and_gives_the_same_map(
    standing: Session, standing_bounded: Pipeline, tmp_path: Path
) -> None:
    middle = 2 * len(standing.messages) // 3  # it still stands
    first, second = tmp_path / "first", tmp_path / "second"
    with running(standing.inputs, first) as run:
        run.feed(standing.messages[:middle])
        before = run.ask("fusion/map")
        run.keep(first / "checkpoint.bin")
        second.mkdir()
        shutil.copy(first / "checkpoint.bin", second)  # as a kill would leave it
    keys = [key for key, _ in read_checkpoint(second / "checkpoint.bin")]
    assert keys.count("lab/camera/c1/sightings") == MOST_ALIKE
    assert MOST_STANDING < keys.count("lab/robot/r1/odom") < MOST_STANDING + 20
    with running(standing.inputs, second) as run:
        # What senders kept for whoever comes back, while the checkpoint is read.
        run.feed(tuple(m for m in standing.messages[:middle] if isinstance(m[1], Sightings)))
        assert run.ask("fusion/map") == before
        run.feed(standing.messages[middle:])
    run.fusion.finish()
    network = load_network(second)
    for name, record in standing_bounded.results().network.cameras.items():
        assert_same_place(network.cameras[name], record)
    keys = [key for key, _ in read_checkpoint(second / "checkpoint.bin")]
    seen = sum(
        bool(m.faces) for n, m in standing.messages if n == "c1" and isinstance(m, Sightings)
    )
    assert (
        keys.count("lab/camera/c1/sightings")
        == seen - run.fusion._pipeline.left_out["standing_still"]
    )
