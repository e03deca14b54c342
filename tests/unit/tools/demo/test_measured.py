"""Results from a folder as a demo leaves it: twelve seconds of the lab, of which c1 was located."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.fusion.networks import located

from trigpoint.base.clock import to_ns
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import Message, Odometry, PoseEstimate
from trigpoint.contract.topics import CAMERA_POSE, CORRECTION, ODOMETRY, ROBOT_POSE, Topic
from trigpoint.geometry import Pose
from trigpoint.map.network import (
    CameraRecord,
    Network,
    PoseRecord,
    RobotRecord,
    Statistics,
    TargetRecord,
    save_network,
)
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.tools.demo.folder import DemoFolder, DemoRecord
from trigpoint.tools.demo.measured import came_by, load_results
from trigpoint.tools.report.demo.results import DemoResults
from trigpoint.tools.simulation.world import World, load_world

EPOCH_NS = 10**18
SECONDS = 12.0
SIGHTINGS_KEY = "lab/camera/c1/sightings"
COUNTS = {
    "edge/c1": {"pictures": 60, "pictures.lost": 2, f"sent {SIGHTINGS_KEY}": 58},
    "fusion/fusion": {f"received {SIGHTINGS_KEY}": 58, "sent lab/robot/r1/correction": 2},
    "robot/r1": {"received lab/robot/r1/correction": 2, "sent lab/robot/r1/odom": 601},
    "recorder/main": {"recorded lab/camera/c1/pose": 2},
}
RECORD = DemoRecord("lab", 2, "charuco", SECONDS, EPOCH_NS, counts=COUNTS)


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("lab", seed=2, target="charuco")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, world: World) -> DemoFolder:
    folder = DemoFolder(tmp_path_factory.mktemp("run") / "demo")
    folder.claim()
    folder.prepare(world, RECORD, "tcp/127.0.0.1:5555")
    write_session(folder.session, world)
    write_network(folder.path, world)
    write_journal(folder.journal("r1"), world)
    return folder


def stamp(t_s: float) -> int:
    return EPOCH_NS + to_ns(t_s)


def write_session(path: Path, world: World) -> None:
    """Odometry and poses to the end; two corrections, sent 30 and 50 ms after their exposures."""
    writer = McapWriter(path)

    def add(topic: Topic, node: str, message: Message, published_ns: int) -> None:
        key = topic.key("lab", node)
        writer.add(topic, key, encode(message), log_ns=published_ns, published_ns=published_ns)

    covariance = np.diag([1e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4])
    odometry = world.odometry("r1")
    for i in range(int(np.sum(odometry.stamps_s <= SECONDS))):
        at = stamp(float(odometry.stamps_s[i]))
        add(ODOMETRY, "r1", Odometry(at, "r1/odom", "r1/base", odometry.poses[i]), at)
        true = world.map_from_base("r1", float(odometry.stamps_s[i]))
        said = PoseEstimate(at, "map", true.disturbed([0.03, 0.04, 0, 0, 0, 0]), covariance)
        add(ROBOT_POSE, "r1", said, at)
    for t_s, delay_s in ((5.0, 0.03), (6.0, 0.05)):
        pose = PoseEstimate(stamp(t_s), "map", world.map_from_base("r1", t_s), covariance)
        add(CORRECTION, "r1", pose, stamp(t_s + delay_s))
        camera = world.camera("c1").map_from_camera
        estimate = PoseEstimate(stamp(t_s), "map", camera, np.eye(6) * 0.01 / t_s)
        add(CAMERA_POSE, "c1", estimate, stamp(t_s))
    writer.finish()


def write_network(folder: Path, world: World) -> None:
    """c1 is found 3 mm too high with a sigma of 2 mm; nothing of the others."""
    found = world.camera("c1").map_from_camera.disturbed([0, 0, 0.003, 0, 0, 0])
    covariance = np.diag([4e-6] * 3 + [1e-6] * 3)
    c1 = located(found, covariance, sightings=40)
    cameras = {name: CameraRecord("unseen") for name in world.cameras} | {"c1": c1}
    robot = RobotRecord("r1.tum", 1.0, 1.0, None, TargetRecord(()))
    network = Network("lab", "", "smoother", cameras, {"r1": robot}, Statistics(1.0, 3))
    end = world.map_from_base("r1", np.array([SECONDS]))
    trajectories = {"r1": (np.array([stamp(SECONDS)]), end)}
    save_network(folder, network, covariance=covariance, trajectories=trajectories)


def write_journal(path: Path, world: World) -> None:
    """The robot believes to be 1 cm ahead, also two seconds after the end of the session."""
    lines = [{"kind": "belief", "stamp_ns": stamp(1.0), "map_from_base": None}]
    for t_s in (4.0, SECONDS, SECONDS + 2.0):
        believed = world.map_from_base("r1", t_s) @ Pose.planar(0.01, 0.0, 0.0)
        record = msgspec.to_builtins(PoseRecord.of(believed))
        lines.append({"kind": "belief", "stamp_ns": stamp(t_s), "map_from_base": record})
    lines.append({"kind": "correction", "stamp_ns": stamp(4.0)})
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


@pytest.fixture(scope="module")
def results(folder: DemoFolder) -> DemoResults:
    return load_results(folder)


def test_located_camera_is_held_against_the_truth(results):
    c1 = results.cameras[0]
    assert c1.error.position == pytest.approx(0.003)
    assert c1.error.sigmas == pytest.approx(1.5)
    assert (c1.pictures, c1.skipped, c1.record.sightings) == (60, 2, 40)


def test_cameras_that_the_robot_did_not_come_by_are_not_missed(results):
    assert [camera.name for camera in results.cameras if camera.came_by] == ["c1"]
    assert not any(camera.is_missed for camera in results.cameras)


def test_robots_ways_are_held_against_the_truth_where_odometry_ends(results):
    (robot,) = results.robots
    assert robot.final_error(robot.live).place_m == pytest.approx(0.05, abs=1e-4)
    assert robot.final_error(robot.believed).place_m == pytest.approx(0.01, abs=1e-4)
    assert robot.final_error(robot.smoothed).place_m == pytest.approx(0.0, abs=1e-4)


def test_latencies_are_from_exposure_to_sending(results):
    assert results.latencies_s == pytest.approx([0.03, 0.05])


def test_uncertainty_is_that_which_was_sent(results):
    (series,) = results.series
    assert series.name == "c1"
    assert series.t_s == pytest.approx([5.0, 6.0])
    assert series.sigma_m == pytest.approx(np.sqrt(3 * 0.01 / np.array([5.0, 6.0])))


def test_counts_come_from_senders_receivers_and_the_recording(results):
    keys = {count.path: count for count in results.keys}
    correction = keys["robot/r1/correction"]
    assert (correction.sent, correction.received, correction.recorded) == (2, {"robot/r1": 2}, 2)
    assert keys["robot/r1/odom"].recorded == 601
    assert keys["camera/c1/sightings"].recorded == 0
    assert not keys["camera/c1/sightings"].is_complete


def test_recorder_counts_as_the_receiver_where_no_other_is(results):
    count = next(count for count in results.keys if count.path == "camera/c1/pose")
    assert count.received == {"recorder/main": 2}


def test_no_bound_is_given_where_one_camera_was_located(results):
    assert results.bound_m is None
    assert results.error.distance is None


@pytest.mark.parametrize(("camera", "expected"), [("c1", True), ("c2", False), ("c6", False)])
def test_camera_is_met_once_it_had_the_target_before_it_for_a_while(world, camera, expected):
    assert came_by(world, camera, SECONDS) is expected
