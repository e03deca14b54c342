"""Networks from Python: what stands in the files, in numpy."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

import trigpoint as tp
from trigpoint.map.network import (
    AlternativeRecord,
    CameraRecord,
    EarlierPose,
    FaceRecord,
    IntrinsicsRecord,
    Network,
    PoseRecord,
    RobotRecord,
    Statistics,
    TargetRecord,
    save_network,
)

LENS = tp.CameraModel(640, 480, 500.0, 501.0, 320.0, 240.0)
JOINT = np.diag([1e-4, 4e-4, 1e-6, 1e-6, 1e-6, 1e-6, 9e-4, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6])
JOINT[0, 6] = JOINT[6, 0] = 1e-4


def located(x: float, covariance: np.ndarray) -> CameraRecord:
    pose = PoseRecord.of(tp.Pose.planar(x, 0.0, 0.0))
    numbers = tuple(covariance.reshape(-1).tolist())
    lens = IntrinsicsRecord.of(LENS, np.arange(9.0))
    earlier = (EarlierPose("1700000000000000001", pose, numbers),)
    return CameraRecord("located", (), (), True, pose, numbers, lens, earlier=earlier)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = AlternativeRecord(PoseRecord.of(tp.Pose.planar(3, 4, 0)), tuple(range(36)), 0.6)
    open_camera = CameraRecord("undetermined", ("two places",), (place,))
    cameras = {
        "c1": located(0.0, JOINT[:6, :6]),
        "c2": open_camera,
        "c3": located(2.0, JOINT[6:, 6:]),
    }
    faces = TargetRecord((FaceRecord(4, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)),))
    odom = PoseRecord.of(tp.Pose.planar(1, 0, 0))
    robots = {
        "r1": RobotRecord("r1.tum", 1.1, 1.0, odom, faces),
        "r2": RobotRecord(None, 1.0, 1.0, None, faces),
    }
    network = Network("lab", "id", "smoother", cameras, robots, Statistics(1.0, 3))
    way = np.array([10, 20]), tp.Pose.planar([0.0, 1.0], 0.0, 0.0)
    save_network(tmp_path, network, covariance=JOINT, trajectories={"r1": way})
    return tmp_path


def test_a_network_is_read_as_arrays(folder: Path) -> None:
    network = tp.read_network(folder / "network.json")
    assert network.located == ["c1", "c3"]
    c1, c2 = network.cameras["c1"], network.cameras["c2"]
    assert c1.covariance is not None
    np.testing.assert_array_equal(c1.covariance, JOINT[:6, :6])
    assert c1.position_sigma == pytest.approx(np.sqrt(5.01e-4))
    assert c1.lens == LENS
    np.testing.assert_array_equal(c1.lens_sigma, np.arange(9.0))
    assert c1.earlier[0].until_ns == 1_700_000_000_000_000_001
    assert np.isnan(c2.position_sigma)
    assert (c2.pose, c2.covariance, c2.undetermined) == (None, None, ("two places",))
    np.testing.assert_allclose(c2.alternatives[0].pose.translation, [3, 4, 0])
    assert c2.alternatives[0].covariance[1, 0] == 6
    robot = network.robots["r1"]
    np.testing.assert_allclose(robot.base_from_faces[4].translation, [0, 0, 1])
    np.testing.assert_array_equal(network.trajectory("r1").stamps_ns, [10, 20])


def test_the_joint_covariance_comes_in_the_order_that_is_asked_for(folder: Path) -> None:
    network = tp.read_network(folder)
    np.testing.assert_array_equal(network.covariance(), JOINT)
    turned = np.r_[6:12, 0:6]
    np.testing.assert_array_equal(network.covariance(["c3", "c1"]), JOINT[np.ix_(turned, turned)])
    between = network.distances()
    assert between.pairs == (("c1", "c3"),)
    np.testing.assert_allclose(between.sigmas_m, np.sqrt(1e-4 + 9e-4 - 2e-4))


def test_errors_are_against_a_truth_as_a_file_or_as_poses(folder: Path) -> None:
    network = tp.read_network(folder)
    truth = {"c1": tp.Pose.planar(0.01, 0.0, 0.0), "c3": tp.Pose.planar(2.0, 0.0, 0.0)}
    record = {"cameras": {name: PoseRecord.of(pose) for name, pose in truth.items()}}
    (folder / "truth.json").write_bytes(msgspec.json.encode(record))
    found = network.errors(truth)
    assert found == network.errors(folder / "truth.json")
    assert found.cameras["c1"].position == pytest.approx(0.01)
    assert found.distance == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda n: n.covariance(["c4"]), "the network has no camera «c4»; did you mean"),
        (lambda n: n.distances([("c1", "c2")]), "camera c2 is undetermined and has no place"),
        (lambda n: n.trajectory("r3"), "the network has no robot «r3»; did you mean"),
        (lambda n: n.trajectory("r2"), "robot r2 could not be tied to the map"),
    ],
)
def test_what_is_not_there_is_one_line(folder: Path, ask, said: str) -> None:
    with pytest.raises(tp.InputError, match=said):
        ask(tp.read_network(folder))


def test_files_that_are_not_beside_it_are_missed_when_they_are_asked_for(folder: Path) -> None:
    (folder / "covariance.npz").unlink()
    (folder / "r1.tum").unlink()
    network = tp.read_network(folder)
    with pytest.raises(tp.InputError, match=r"keep covariance.npz beside network.json"):
        network.covariance()
    with pytest.raises(tp.InputError, match=r"r1.tum: cannot be read"):
        network.trajectory("r1")
