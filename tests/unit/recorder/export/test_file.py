"""Exports, as the tools that they are for read them."""

import json
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from support.builders import make_odometry, site_text
from support.commands import Cli
from support.fusion.networks import located

from trigpoint.cli import run
from trigpoint.contract import cdr
from trigpoint.contract.topics import ODOMETRY
from trigpoint.geometry import CameraModel, Pose
from trigpoint.map.network import (
    Network,
    Statistics,
    decode_tum,
    encode_network,
)
from trigpoint.recorder.mcap.check import check
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.site.camera_info import parse_camera_info

SITE = site_text(cameras=2, more="[map]\norigin = [20.0, 10.0, 0.5]")
LENS = CameraModel.from_field_of_view(640, 480, 1.0)
POSES = {"c1": Pose.planar(1.0, 2.0, 0.3), "c2": Pose.planar(-1.0, 0.5, -1.2)}


def network() -> Network:
    cameras = {name: located(pose, np.eye(6), lens=LENS) for name, pose in POSES.items()}
    return Network("lab", "id", "smoother", cameras, {}, Statistics(None, 0))


@pytest.fixture(scope="module")
def exported(session_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    (folder / "site.toml").write_text(SITE)
    (folder / "network.json").write_bytes(encode_network(network()))
    words = ["export", str(session_file), "--out", str(folder), "--network", str(folder)]
    words += ["--site", str(folder / "site.toml")]
    assert run([*words, *_formats("tum", "kalibr", "ros", "launch", "mcap")]) == 0
    return folder


def _formats(*names: str) -> list[str]:
    return [word for name in names for word in ("--format", name)]


@pytest.mark.parametrize("name", ["rrd", "mcap"])
def test_a_session_without_a_site_is_drawn_by_the_one_that_is_given(
    tmp_path: Path, name: str
) -> None:
    writer = McapWriter(tmp_path / "s.mcap")
    payload = cdr.encode(make_odometry(5))
    writer.add(ODOMETRY, ODOMETRY.key("lab", "r1"), payload, log_ns=5, published_ns=5)
    writer.finish()
    (tmp_path / "site.toml").write_text(site_text(cameras=1))
    words = ["export", str(tmp_path / "s.mcap"), "--out", str(tmp_path / "out"), "--format", name]
    assert run([*words, "--site", str(tmp_path / "site.toml")]) == 0
    assert run(words) == 2


def test_trajectories_are_tum_files(exported: Path) -> None:
    for what in ("odometry", "corrected"):
        stamps_ns, poses = decode_tum((exported / f"r1_{what}.tum").read_bytes())
        assert len(stamps_ns) == 80
        assert stamps_ns[0] == 1_760_000_000_000_000_000
        assert poses.translation.shape == (80, 3)


def test_kalibrs_chain_goes_from_camera_to_camera(exported: Path) -> None:
    chain = YAML(typ="safe").load((exported / "camchain.yaml").read_text())
    assert list(chain) == ["cam0", "cam1"]
    assert chain["cam0"]["intrinsics"] == pytest.approx([LENS.fx, LENS.fy, LENS.cx, LENS.cy])
    assert chain["cam0"]["resolution"] == [640, 480]
    point_c1 = np.array([0.3, -0.2, 2.0])
    expected = POSES["c2"].inverse() @ (POSES["c1"] @ point_c1)
    mapped = np.array(chain["cam1"]["T_cn_cnm1"]) @ [*point_c1, 1.0]
    np.testing.assert_allclose(mapped[:3], expected, atol=1e-12)


def test_lenses_are_ros_files(exported: Path) -> None:
    assert parse_camera_info((exported / "c1.yaml").read_text(), file="c1.yaml") == LENS


def test_the_launch_file_says_every_camera(exported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes: list[dict] = []
    for name, members in {
        "launch": {"LaunchDescription": list},
        "launch_ros": {},
        "launch_ros.actions": {"Node": lambda **options: nodes.append(options)},
    }.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    runpy.run_path(str(exported / "cameras.launch.py"))["generate_launch_description"]()
    arguments = [dict(zip(n["arguments"][::2], n["arguments"][1::2], strict=True)) for n in nodes]
    assert [one["--child-frame-id"] for one in arguments] == ["c1/optical", "c2/optical", "map"]
    assert float(arguments[0]["--x"]) == 1.0
    assert [one["--frame-id"] for one in arguments] == ["map", "map", "building"]
    assert float(arguments[2]["--x"]) == 20.0


def test_the_drawable_recording_has_all_that_viewers_need(exported: Path) -> None:
    file = exported / "drawable.mcap"
    assert check(file).is_sound
    with AnyReader([file], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        topics = {c.topic: c.msgtype for c in reader.connections}
        read: dict[str, list] = {}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            read.setdefault(connection.topic, []).append(message)
    assert topics["/lab/camera/c1/annotations"] == "foxglove_msgs/msg/ImageAnnotations"
    placed = read["/lab/tf_static"][0].transforms
    assert [t.child_frame_id for t in placed] == ["map", "c1/optical", "c2/optical"]
    assert placed[0].header.frame_id == "building"
    pictures, infos = read["/lab/camera/c1/image/compressed"], read["/lab/camera/c1/camera_info"]
    stamps = {(m.header.stamp.sec, m.header.stamp.nanosec) for m in infos}
    assert {(m.header.stamp.sec, m.header.stamp.nanosec) for m in pictures} <= stamps
    sightings = [len(m.faces) for m in read["/lab/camera/c1/sightings"]]
    assert [len(m.points) for m in read["/lab/camera/c1/annotations"]] == sightings
    assert any(sightings)


def test_layouts_name_topics_that_are_there(exported: Path) -> None:
    layout = json.loads((exported / "foxglove_layout.json").read_text())
    image = SimpleNamespace(**layout["configById"]["Image!c1"]["imageMode"])
    assert image.imageTopic == "/lab/camera/c1/image/compressed"
    assert list(image.annotations) == ["/lab/camera/c1/annotations"]
    with AnyReader([exported / "drawable.mcap"]) as reader:
        there = {connection.topic for connection in reader.connections}
    in_map = set(layout["configById"]["3D!map"]["topics"])
    drawn = ("tf", "tf_static", "camera/c1/camera_info", "coverage/c1", "robot/r1/pose")
    assert {f"/lab/{path}" for path in drawn} <= in_map & there
    rviz = YAML(typ="safe").load((exported / "trigpoint.rviz").read_text())
    topics = {
        display["Topic"]["Value"]
        for display in rviz["Visualization Manager"]["Displays"]
        if "Topic" in display
    }
    assert "/lab/robot/r1/odom" in topics
    assert "/lab/camera/c1/image/compressed" in topics


def test_without_a_network_its_formats_are_refused(
    session_file: Path, tmp_path: Path, cli: Cli
) -> None:
    words = ["export", str(session_file), "--out", str(tmp_path)]
    assert "trigpoint calibrate" in cli.refused(*words, "--format", "kalibr")
    assert "there is none such" in cli.refused(*words, "--format", "word")
