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
from support.builders import TARGET_TEXT, make_odometry, site_text
from support.commands import Cli, Said
from support.fusion.foreign import as_foreign
from support.pictures.boards import CAMERA, charuco, picture_of, placed, plain_picture

from trigpoint.contract import cdr
from trigpoint.contract.cdr_ros import Builder, store
from trigpoint.contract.messages import CameraInfo, Odometry, Sightings
from trigpoint.fusion.inputs import load_inputs
from trigpoint.site.config import load_site
from trigpoint.tools.sessions.bag import bag_messages, parse_roles

GREY = picture_of([placed(charuco(), distance=0.8, tilt_deg=15)])
COLOUR = np.stack([GREY] * 3, axis=-1)
build = Builder()


def raw(picture: np.ndarray, encoding: str, padding: int = 0) -> Any:
    rows = picture.reshape(picture.shape[0], -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    size = {"height": picture.shape[0], "width": picture.shape[1], "step": rows.shape[1]}
    form = {"encoding": encoding, "is_bigendian": 0, "data": rows.reshape(-1)}
    return build("sensor_msgs/Image", header=build.header(10**9, "camera"), **size, **form)


def compressed(picture: np.ndarray) -> Any:
    data = cv2.imencode(".png", picture)[1].reshape(-1)
    header = build.header(2 * 10**9, "camera")
    return build("sensor_msgs/CompressedImage", header=header, format="png", data=data)


def write_bag(path: Path, plugin: StoragePlugin, topics: dict[str, list[Any]]) -> Path:
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store())
            for number, message in enumerate(messages):
                data = store().serialize_cdr(message, kind)
                writer.write(connection, 10**9 * (number + 1), data)
    return path


def faces(said: Said) -> list[list[dict[str, Any]]]:
    return [json.loads(line)["faces"] for line in said.out.splitlines()]


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bags_pictures_are_searched_as_files_are(
    tmp_path: Path, target: Path, plugin: StoragePlugin, cli: Cli
) -> None:
    (tmp_path / "shots").mkdir()
    cv2.imwrite(str(tmp_path / "shots" / "a.png"), GREY)
    (expected,) = faces(cli("detect", tmp_path / "shots", "--target", target, "--json"))
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
    words = ["detect", bag, "--target", target, "--json", "--topic"]
    assert faces(cli(*words, "/front/image_raw")) == [expected] * 5
    assert faces(cli(*words, "/back/image/compressed")) == [expected]


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
    views = [picture_of([placed(charuco(), distance=d, tilt_deg=t)]) for t, d in tilts]
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


def test_a_foreign_bag_is_calibrated_to_the_same_network(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    expected = json.loads(cli("calibrate", recorded, "--json", "--out", tmp_path / "own").out)
    words = as_foreign(recorded, tmp_path, plugin=StoragePlugin.SQLITE3)
    site = ("--site", tmp_path / "site.toml")
    assert json.loads(cli("calibrate", *words, *site, "--json").out) == expected
    assert "--site" in cli.refused("calibrate", *words)


def test_a_packed_session_is_calibrated_as_it_was_before(
    recorded: Path, tmp_path: Path, cli: Cli
) -> None:
    file = recorded / "session.mcap"
    packed = tmp_path / "packed" / "session.mcap.zstd"
    packed.parent.mkdir()
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    expected = cli("calibrate", file, "--json", "--out", tmp_path / "own").out
    assert cli("calibrate", packed.parent, "--json").out == expected
    assert (packed.parent / "calibration").is_dir()
    cli("review", packed.parent, "--save", tmp_path / "a.rrd")


def test_pictures_of_a_bag_become_sightings_with_the_lens_beside_them(
    tmp_path: Path, target: Path
) -> None:
    (tmp_path / "site.toml").write_text(
        'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "dir://x"\n'
        '[robots.r1]\nport = "loop://"\n'
    )
    sent = {
        "/front/camera_info": CameraInfo(10**9, "camera", CAMERA),
        "/odom": make_odometry(10**9),
    }
    topics = {
        topic: [store().deserialize_cdr(cdr.encode(message), cdr.type_name(message))]
        for topic, message in sent.items()
    }
    bag = write_bag(
        tmp_path / "bag", StoragePlugin.MCAP, {"/front/image_raw": [raw(GREY, "mono8")], **topics}
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


def test_board_that_the_target_file_has_wrong_is_said_by_calibrate(
    tmp_path: Path, target: Path, cli: Cli
) -> None:
    target.write_text(target.read_text().replace("DICT_4X4_250", "DICT_5X5_250"))
    (tmp_path / "site.toml").write_text(
        'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "dir://x"\n'
        'horizontal_fov = 60.0\n[robots.r1]\nport = "loop://"\n'
    )
    odometry = [make_odometry(10**9 + number * 10**8, x=0.01 * number) for number in range(20)]
    topics = {
        "/odom": [store().deserialize_cdr(cdr.encode(one), cdr.type_name(one)) for one in odometry],
        "/front/camera_info": [
            store().deserialize_cdr(cdr.encode(one), cdr.type_name(one))
            for one in [CameraInfo(10**9, "camera", CAMERA)]
        ],
        "/front/image_raw": [raw(GREY, "mono8")],
    }
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP, topics)
    words = ["calibrate", bag, "--site", tmp_path / "site.toml", "--topic", "c1=/front/image_raw"]
    assert "add --topic r1=/odom" in cli.refused(*words)
    alone = cli.refused(*words[:-1], "r1=/odom")
    assert "no --topic names what a camera saw; there is /front/image_raw: add" in alone
    said = cli(*words, "--topic", "r1=/odom", "--out", tmp_path / "out", status=1)
    assert "c1 is unseen: face 0" in said.err
    assert 'write dictionary = "DICT_4X4_250"' in said.err
    assert "DICT_4X4_250" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("roles", "said"),
    [
        (["c1=/a", "c2=/a"], "/a is given twice, as c1 and c2; each topic is one"),
        (["c1=/a", "c1=/a"], "/a is given twice for c1; once is enough"),
        (["c1=/a", "c1=/b"], "gives c1 both /a and /b: give one of them"),
        (["r1=/odom", "r1=/odom2"], "gives r1 both /odom and /odom2: give one of them"),
    ],
)
def test_topic_of_two_and_two_of_one_are_refused(
    tmp_path: Path, cli: Cli, roles: list[str], said: str
) -> None:
    """Before, the last one was taken, and the other was «unseen» without a word."""
    (tmp_path / "site.toml").write_text(site_text(cameras=2))
    (tmp_path / "target.toml").write_text(TARGET_TEXT)
    odometry = store().deserialize_cdr(cdr.encode(make_odometry(10**9)), "nav_msgs/msg/Odometry")
    pictures = {topic: [raw(GREY, "mono8")] for topic in ("/a", "/b")}
    drives = {topic: [odometry] for topic in ("/odom", "/odom2")}
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP, {**pictures, **drives})
    words = ["calibrate", bag, "--site", tmp_path / "site.toml"]
    assert said in cli.refused(*words, *(word for role in roles for word in ("--topic", role)))
