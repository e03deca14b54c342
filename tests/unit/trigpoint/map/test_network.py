import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.builders import largest_file

from trigpoint.base.errors import InputError, OperationError
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import (
    CameraRecord,
    EarlierPose,
    FaceRecord,
    IntrinsicsRecord,
    Network,
    PoseRecord,
    RobotRecord,
    Statistics,
    TargetRecord,
    decode_network,
    decode_tum,
    encode_network,
    encode_tum,
    load_network,
    save_network,
)

CAMERA = CameraModel(640, 480, 500.0, 501.0, 320.0, 240.0, (-0.2, 0.05, 1e-3, 0.0, 0.0))
POSE = Pose.from_vector([1.0, 2.0, 3.0, 0.1, -0.2, 0.3])


def make_network() -> Network:
    located = CameraRecord(
        status="located",
        map_from_camera=PoseRecord.of(POSE),
        covariance=tuple(float(value) for value in np.diag([4e-4, 4e-4, 1e-4, 0, 0, 0]).ravel()),
        intrinsics=IntrinsicsRecord.of(CAMERA, np.arange(9.0)),
        sightings=12,
        rejected=1,
        reprojection_rms=0.24,
        earlier=(EarlierPose("17", PoseRecord.of(POSE), (0.0,) * 36),),
    )
    undetermined = CameraRecord(status="undetermined", undetermined=("height",))
    robot = RobotRecord(
        "r1.tum",
        1.0,
        1.0,
        PoseRecord.of(POSE),
        TargetRecord((FaceRecord(0, (0, 0, 0), (0, 0, 0, 1)),)),
    )
    return Network(
        site="lab",
        map_id="uuid",
        estimator="smoother",
        cameras={"c1": located, "c2": undetermined, "c3": CameraRecord(status="unseen")},
        robots={"r1": robot},
        statistics=Statistics(1.0, 7),
    )


def test_network_survives_the_way_to_bytes_and_back() -> None:
    network = make_network()
    assert decode_network(encode_network(network)) == network
    assert encode_network(network) == encode_network(make_network())


def test_network_has_the_contracts_format() -> None:
    document = json.loads(encode_network(make_network()))
    assert document["format"] == "trigpoint-network/1"
    assert document["map"] == "map"
    assert list(document["cameras"]["c1"]["intrinsics"]["sigma"]) == ["fx", "fy", "cx", "cy", "d"]
    assert document["cameras"]["c2"]["map_from_camera"] is None


def test_records_give_back_what_they_were_made_of() -> None:
    camera = make_network().cameras["c1"]
    assert camera.intrinsics is not None
    assert camera.map_from_camera is not None
    assert camera.intrinsics.camera == CAMERA
    np.testing.assert_allclose(camera.map_from_camera.pose.rotation, POSE.rotation, atol=1e-12)
    np.testing.assert_allclose(camera.position_sigma, 0.03)


def test_camera_that_is_not_located_has_no_covariance() -> None:
    network = make_network()
    assert network.located == ["c1"]
    with pytest.raises(ValueError, match="undetermined"):
        _ = network.cameras["c2"].covariance_matrix


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "no network file"),
        (b"{}", "no network file"),
        (b"\xff", "no network file"),
        (encode_network(make_network()).replace(b"network/1", b"network/9"), "is not trigpoint"),
    ],
)
def test_what_is_no_network_is_refused(data: bytes, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint) as caught:
        decode_network(data, source="n.json")
    assert str(caught.value).startswith("n.json: ")


def test_files_are_written_whole_and_read_back(tmp_path: Path) -> None:
    network = make_network()
    stamps = np.array([1_700_000_000_123_456_789, 1_700_000_000_223_456_789])
    poses = Pose.stack([POSE, POSE.inverse()])
    for _ in range(2):  # the second time over the first
        save_network(tmp_path, network, covariance=np.eye(6), trajectories={"r1": (stamps, poses)})
    assert load_network(tmp_path) == load_network(tmp_path / "network.json") == network
    with np.load(tmp_path / "covariance.npz") as archive:
        assert archive["cameras"].tolist() == ["c1"]
        np.testing.assert_array_equal(archive["covariance"], np.eye(6))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "covariance.npz",
        "network.json",
        "r1.tum",
    ]


def test_full_disk_leaves_the_earlier_network_as_it_was(tmp_path: Path) -> None:
    network, stamps = make_network(), np.arange(400)
    way = Pose.stack([POSE] * len(stamps))
    save_network(tmp_path, network, covariance=np.eye(6), trajectories={})
    with largest_file(10_000), pytest.raises(OperationError, match="cannot be written"):
        save_network(tmp_path, network, covariance=np.eye(6), trajectories={"r1": (stamps, way)})
    assert load_network(tmp_path) == network
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["covariance.npz", "network.json"]


@given(
    st.lists(st.integers(0, 2**62), max_size=5),
    arrays(float, (5, 6), elements=st.floats(-3, 3)),
)
def test_trajectory_keeps_its_nanoseconds(stamps: list[int], vectors: Array) -> None:
    stamps_ns = np.array(stamps, dtype=np.int64)
    poses = Pose.from_vector(vectors[: len(stamps)])
    read_ns, read = decode_tum(encode_tum(stamps_ns, poses))
    np.testing.assert_array_equal(read_ns, stamps_ns)
    np.testing.assert_allclose(read.translation, poses.translation, atol=1e-9)
    np.testing.assert_allclose(read.rotation, poses.rotation, atol=1e-8)


def test_trajectory_with_a_bad_row_names_its_line() -> None:
    with pytest.raises(InputError, match=r"r1\.tum:3: no row"):
        decode_tum(b"# a comment\n1.0 0 0 0 0 0 0 1\n2.0 0 0\n", source="r1.tum")


def test_absent_network_names_its_path(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"network\.json: there is no such network file"):
        load_network(tmp_path)
