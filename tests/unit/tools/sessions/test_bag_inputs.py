"""Anybody's bag as input of `detect`, `intrinsics` and `calibrate`: sqlite and MCAP, raw and
compressed, foreign topics."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.builders import make_odometry
from support.commands import Cli
from support.fusion.drives import Session, lab_plan, make_session, write_session
from support.pictures.boards import (
    CAMERA,
    CHARUCO_TARGET,
    charuco,
    picture_of,
    placed,
    plain_picture,
)

from trigpoint.cli import run
from trigpoint.contract import cdr
from trigpoint.contract.messages import SIGHTINGS, CameraInfo, Odometry, Sightings
from trigpoint.contract.topics import ODOMETRY as ODOMETRY_TOPIC
from trigpoint.fusion.inputs import load_inputs
from trigpoint.recorder.session.recording import open_recording
from trigpoint.site.config import load_site
from trigpoint.tools.sessions.bag import bag_messages, parse_roles

STORE = get_typestore(Stores.ROS2_JAZZY)
HEADER, TIME = STORE.types["std_msgs/msg/Header"], STORE.types["builtin_interfaces/msg/Time"]
IMAGE = STORE.types["sensor_msgs/msg/Image"]
COMPRESSED = STORE.types["sensor_msgs/msg/CompressedImage"]
BOARD = charuco()
GREY = picture_of([placed(BOARD, distance=0.8, tilt_deg=15)])
COLOUR = np.stack([GREY] * 3, axis=-1)


def header(stamp_s: int) -> Any:
    return HEADER(stamp=TIME(sec=stamp_s, nanosec=0), frame_id="camera")


def raw(picture: np.ndarray, encoding: str, padding: int = 0) -> Any:
    rows = picture.reshape(picture.shape[0], -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    height, width = picture.shape[:2]
    return IMAGE(
        header=header(1),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def compressed(picture: np.ndarray) -> Any:
    data = cv2.imencode(".png", picture)[1].reshape(-1)
    return COMPRESSED(header=header(2), format="png", data=data)


def write_bag(path: Path, plugin: StoragePlugin, topics: dict[str, list[Any]]) -> Path:
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number, message in enumerate(messages):
                data = STORE.serialize_cdr(message, kind)
                writer.write(connection, 10**9 * (number + 1), data)
    return path


@pytest.fixture
def target(tmp_path: Path) -> Path:
    path = tmp_path / "target.toml"
    path.write_text(CHARUCO_TARGET)
    return path


def faces(capsys: pytest.CaptureFixture[str]) -> list[list[dict[str, Any]]]:
    return [json.loads(line)["faces"] for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bags_pictures_are_searched_as_files_are(
    tmp_path: Path, target: Path, plugin: StoragePlugin, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "shots").mkdir()
    cv2.imwrite(str(tmp_path / "shots" / "a.png"), GREY)
    assert run(["detect", str(tmp_path / "shots"), "--target", str(target), "--json"]) == 0
    (expected,) = faces(capsys)
    bag = write_bag(
        tmp_path / "bag",
        plugin,
        {
            "/front/image_raw": [
                raw(GREY, "mono8"),
                raw(GREY, "mono8", padding=7),
                raw(COLOUR, "bgr8"),
                raw(COLOUR, "rgb8"),
                raw(GREY.astype(np.uint16) * 256, "mono16"),
            ],
            "/back/image/compressed": [compressed(GREY)],
        },
    )
    words = ["detect", str(bag), "--target", str(target), "--json", "--topic"]
    assert run([*words, "/front/image_raw"]) == 0
    assert faces(capsys) == [expected] * 5
    assert run([*words, "/back/image/compressed"]) == 0
    assert faces(capsys) == [expected]


def test_which_topic_is_asked_for_where_there_are_several(
    tmp_path: Path, target: Path, cli: Cli
) -> None:
    pictures = {"/a": [compressed(GREY)], "/b": [compressed(plain_picture())]}
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP, pictures)
    assert "several topics with pictures (/a, /b)" in cli.refused("detect", bag, "--target", target)
    assert "there is no topic /c" in cli.refused("detect", bag, "--target", target, "--topic", "/c")


def test_a_damaged_bag_is_one_line(tmp_path: Path, target: Path, cli: Cli) -> None:
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n and no more")
    error = cli.refused("detect", tmp_path / "x.mcap", "--target", target)
    assert error.count("\n") == 1
    assert "trigpoint check" in error


def test_intrinsics_come_out_of_a_bag(tmp_path: Path, target: Path, cli: Cli) -> None:
    tilts = [(-35, 0.7), (-20, 0.9), (0, 0.6), (15, 0.8), (25, 1.0), (40, 0.75)]
    views = [picture_of([placed(BOARD, distance=d, tilt_deg=t)]) for t, d in tilts]
    shots = tmp_path / "shots"
    shots.mkdir()
    for number, view in enumerate(views):
        cv2.imwrite(str(shots / f"{number}.png"), view)
    messages = {"/camera/image_raw": [raw(view, "mono8") for view in views]}
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, messages)
    lenses = []
    for pictures in (shots, bag):
        out = tmp_path / f"{pictures.name}.yaml"
        cli("intrinsics", pictures, "--target", target, "--out", out)
        lenses.append(out.read_text().replace(pictures.name, ""))
    assert lenses[0] == lenses[1]


@pytest.fixture(scope="module")
def drive() -> Session:
    return make_session(lab_plan(picture_rate=1.0))


def test_a_foreign_bag_is_calibrated_to_the_same_network(
    drive: Session, tmp_path: Path, cli: Cli
) -> None:
    recorded = write_session(drive, tmp_path / "own")
    expected = json.loads(cli("calibrate", recorded, "--json").out)
    bag, roles = _as_foreign(recorded, tmp_path / "bag")
    site = tmp_path / "site.toml"
    recording = open_recording(recorded)
    for name, data in recording.attachments.items():
        (tmp_path / name).write_bytes(data)
    words = [word for role in roles for word in ("--topic", role)]
    assert json.loads(cli("calibrate", bag, "--site", site, "--json", *words).out) == expected
    assert "--site" in cli.refused("calibrate", bag, *words)


def test_a_packed_session_is_calibrated_as_it_was_before(
    drive: Session, tmp_path: Path, cli: Cli
) -> None:
    file = next(write_session(drive, tmp_path / "own").glob("*.mcap"))
    packed = tmp_path / "packed" / "session.mcap.zstd"
    packed.parent.mkdir()
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    expected = cli("calibrate", file, "--json").out
    assert cli("calibrate", packed.parent, "--json").out == expected
    assert (packed.parent / "calibration").is_dir()
    cli("review", packed.parent, "--save", tmp_path / "a.rrd")


def _as_foreign(recorded: Path, path: Path) -> tuple[Path, list[str]]:
    """The session as a bag of other topics, and whose they are."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in (SIGHTINGS, "trigpoint_msgs/msg/FaceSighting"):
        store.register(get_types_from_msg(_definition(name), name))
    roles, connections = [], {}
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for sample in open_recording(recorded).samples():
            if sample.key not in connections:
                topic = f"/foreign/{len(connections)}"
                roles.append(f"{sample.key.split('/')[2]}={topic}")
                connections[sample.key] = writer.add_connection(
                    topic, sample.topic.type_name, typestore=store
                )
            writer.write(connections[sample.key], sample.log_ns, sample.payload)
    return path, roles


def _definition(name: str) -> str:
    text = cdr.definition(SIGHTINGS)
    first, *others = text.split("=" * 80 + "\n")
    for other in others:
        title, _, body = other.partition("\n")
        if title == f"MSG: {name.replace('/msg/', '/')}":
            return body
    return first


def test_pictures_of_a_bag_become_sightings_with_the_lens_beside_them(
    tmp_path: Path, target: Path
) -> None:

    (tmp_path / "site.toml").write_text(
        'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "dir://x"\n'
        '[robots.r1]\nport = "loop://"\n'
    )
    info = store_info()
    bag = write_bag(
        tmp_path / "bag",
        StoragePlugin.MCAP,
        {"/front/image_raw": [raw(GREY, "mono8")], "/front/camera_info": [info], "/odom": [odom()]},
    )
    inputs = load_inputs(load_site(tmp_path / "site.toml"))
    roles = parse_roles(["c1=/front/image_raw", "r1=/odom"])
    messages = dict.fromkeys(type(m) for _, m in bag_messages(bag, roles, inputs).in_order)
    assert set(messages) == {CameraInfo, Odometry, Sightings}
    ((name, sighting),) = [
        (n, m) for n, m in bag_messages(bag, roles, inputs).in_order if isinstance(m, Sightings)
    ]
    assert name == "c1"
    assert len(sighting.faces) == 1


def store_info() -> Any:
    message = CameraInfo(10**9, "camera", CAMERA)
    return STORE.deserialize_cdr(cdr.encode(message), "sensor_msgs/msg/CameraInfo")


def odom() -> Any:

    return STORE.deserialize_cdr(cdr.encode(make_odometry(10**9)), ODOMETRY_TOPIC.type_name)
