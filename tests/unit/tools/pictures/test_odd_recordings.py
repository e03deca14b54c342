"""Recordings as people have them: one bad message among good ones, anything that MCAP lets a writer
leave out, foreign encodings."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
from ruamel.yaml import YAML
from support.builders import make_odometry
from support.commands import Cli
from support.pictures.boards import CHARUCO_TARGET
from support.pictures.recordings import GREY, PNG, SOUND, TOPIC, write

from trigpoint.cli import run
from trigpoint.contract import cdr
from trigpoint.contract.cdr_ros import Builder, store
from trigpoint.contract.messages import ODOMETRY, PICTURE, RAW_IMAGE, Picture
from trigpoint.recorder.session.bag import Bag
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.pictures.bag import grey_of

BAD = {
    "nothing": b"",
    "cut": SOUND[:21],
    "noise": bytes(range(256)),
    "no picture": cdr.encode(Picture(0, "", "png", b"")),
    "half a picture": cdr.encode(Picture(0, "", "png", PNG[: len(PNG) // 2])),
    "another picture's end": cdr.encode(Picture(0, "", "png", PNG[len(PNG) // 2 :])),
}


@pytest.mark.parametrize("bad", BAD)
def test_one_bad_picture_is_left_out_and_named_by_its_time(
    tmp_path: Path, target: Path, bad: str, cli: Cli
) -> None:
    bag = write(tmp_path / "bag.mcap", [SOUND, BAD[bad], SOUND])
    told = cli("detect", bag, "--target", target)
    assert told.out.count("face 0") == 2
    assert f"1 picture left out: {bag}: a picture of {TOPIC}, at 1001.000 s" in told.err


@pytest.mark.parametrize("bad", ["nothing", "no picture"])
def test_nothing_but_bad_pictures_is_status_1(tmp_path: Path, target: Path, bad: str) -> None:
    bag = write(tmp_path / "bag.mcap", [BAD[bad]] * 2)
    assert run(["detect", str(bag), "--target", str(target)]) == 1


@pytest.mark.parametrize("bad", BAD)
def test_check_names_what_recover_leaves_out(tmp_path: Path, bad: str, cli: Cli) -> None:
    bag = write(tmp_path / "bag.mcap", [SOUND, BAD[bad], SOUND])
    said = cli("check", bag, status=1).out
    assert re.search(rf"a message of {TOPIC} (cannot|holds).*, at 1001\.000 s", said)
    whole = tmp_path / "whole" / "whole.mcap"
    cli("recover", bag, "--out", whole)
    cli("check", whole)
    assert open_recording(whole).counts == {TOPIC[1:]: 2}
    metadata = YAML(typ="safe").load((whole.parent / "metadata.yaml").read_text())
    (topic,) = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    assert topic["topic_metadata"]["type"] == PICTURE


JPEG = cv2.imencode(".jpg", GREY)[1].tobytes()


END = b"\xff\xd9"


@pytest.mark.parametrize("after", [END, b"\0" + END, END + b"\0"])
def test_a_picture_without_its_head_is_cut_short_whatever_its_end(after: bytes) -> None:
    begins = JPEG.rfind(b"\xff\xda") + 2
    begins += int.from_bytes(JPEG[begins : begins + 2], "big")
    for length in range(2, begins):
        picture = Picture(0, "", "jpeg", JPEG[:length] + after)
        assert "cut short" in cdr.fault_in(PICTURE, cdr.encode(picture))


@settings(deadline=None)
@given(st.sampled_from([PNG, JPEG]), st.floats(0, 1, exclude_max=True), st.binary(max_size=4))
def test_what_check_lets_pass_can_be_decoded(whole: bytes, share: float, after: bytes) -> None:
    for data in (whole[: int(share * len(whole))] + after, whole[-1 - len(after) :], whole + after):
        picture = Picture(0, "", "bgr8; jpeg compressed bgr8", data)
        if not cdr.fault_in(PICTURE, cdr.encode(picture)):
            assert grey_of(picture).shape == GREY.shape
    assert not cdr.fault_in(PICTURE, cdr.encode(Picture(0, "", "png", whole + after)))


@given(
    encoding=st.sampled_from(["", "mono8", "12FC3"]),
    width=st.integers(0, 5),
    height=st.integers(0, 5),
    size=st.integers(0, 30),
)
def test_check_names_raw_pictures_that_hold_too_little(
    encoding: str, width: int, height: int, size: int
) -> None:
    header = Builder().header(0, "")
    shape = {"height": height, "width": width, "step": 0}
    form = {"encoding": encoding, "is_bigendian": 0}
    image = Builder()(
        "sensor_msgs/Image", header=header, **shape, **form, data=np.zeros(size, np.uint8)
    )
    is_sound = bool(encoding) and 0 < width * height <= size
    payload = bytes(store().serialize_cdr(image, RAW_IMAGE))
    assert (not cdr.fault_in(RAW_IMAGE, payload)) == is_sound


def test_a_warning_is_said_once_with_how_often(tmp_path: Path, cli: Cli) -> None:
    out = cli("check", write(tmp_path / "bag.mcap", [b""] * 7), status=1).out
    assert out.count("\n") == 1
    assert "and 6 more like it" in out


LEFT_OUT = ("repeat_channels", "repeat_schemas", "use_chunking", "use_statistics",
            "use_summary_offsets", "enable_crcs", "enable_data_crcs")  # fmt: skip


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    indexes=st.sets(st.sampled_from(list(IndexType))),
    compression=st.sampled_from(CompressionType),
    options=st.fixed_dictionaries({name: st.booleans() for name in LEFT_OUT}),
    chunk_size=st.sampled_from([1, 1 << 20]),
)
def test_whatever_a_writer_leaves_out_all_messages_are_read(
    tmp_path: Path,
    indexes: set[IndexType],
    compression: CompressionType,
    options: dict[str, Any],
    chunk_size: int,
) -> None:
    kinds = IndexType.NONE
    for kind in indexes:
        kinds |= kind
    file = write(
        tmp_path / "bag.mcap",
        [SOUND] * 4,
        index_types=kinds,
        compression=compression,
        chunk_size=chunk_size,
        **options,
    )
    assert open_recording(file).counts == {TOPIC[1:]: 4}
    assert sum(one.log_ns > 0 for one in Bag(file).messages([TOPIC], never)) == 4


def test_a_topics_type_is_what_most_of_its_messages_are(
    tmp_path: Path, target: Path, cli: Cli
) -> None:
    bag, stray = tmp_path / "bag.mcap", cdr.encode(make_odometry(10**9))
    writer = Writer(str(bag))
    writer.start(profile="ros2", library="theirs")
    for number, kind in enumerate((PICTURE, ODOMETRY, PICTURE)):
        schema = writer.register_schema(kind, "ros2msg", cdr.definition(kind).encode())
        channel = writer.register_channel(TOPIC, "cdr", schema)
        writer.add_message(channel, number, SOUND if kind == PICTURE else stray, number)
    writer.finish()
    for file in (bag, tmp_path / "whole.mcap"):
        told = cli("detect", file, "--target", target)
        assert told.out.count("face 0") == 2
        assert f"is a {ODOMETRY}, not a {PICTURE}" in told.err
        assert f"2 of {PICTURE}, 1 of {ODOMETRY}" in cli("check", file).out
        if file == bag:
            cli("recover", bag, "--out", tmp_path / "whole.mcap")


def test_a_foreign_topic_may_be_named_like_a_sessions(
    tmp_path: Path, target: Path, cli: Cli
) -> None:
    bag = write(tmp_path / "bag.mcap", [SOUND], topic="/lab/robot/r1/odom")
    cli("detect", bag, "--target", target)
    for command in ("info", "check", "recover"):
        cli(command, bag)
    assert "by --topic" in cli.refused("calibrate", bag)


def test_nothing_is_written_where_nothing_can_be_saved(tmp_path: Path) -> None:
    bag, whole = write(tmp_path / "bag.mcap", [b"", b"no"]), tmp_path / "whole" / "whole.mcap"
    assert run(["recover", str(bag), "--out", str(whole)]) == 1
    assert not list(whole.parent.iterdir())


def never(*reason: object) -> None:
    raise AssertionError(reason)


def test_a_topic_without_pictures_is_said_and_the_status_is_1(
    tmp_path: Path, target: Path, cli: Cli
) -> None:
    bag = write(tmp_path / "bag.mcap", [])
    for command in ("detect", "intrinsics"):
        assert (
            "no picture is in what was given" in cli(command, bag, "--target", target, status=1).err
        )


def test_check_sends_nobody_to_recover_where_nothing_can_be_saved(tmp_path: Path, cli: Cli) -> None:
    bag = write(tmp_path / "bag.mcap", [SOUND] * 2)
    bag.write_bytes(bag.read_bytes()[:60])
    assert "copy or record it anew" in (said := cli("check", bag, status=1)).err
    assert "recover" not in said.err


@pytest.mark.parametrize(("encoding", "words"), [("ros1", "ROS 1"), ("json", "JSON")])
def test_what_is_no_cdr_is_named_as_what_it_is(
    tmp_path: Path, target: Path, encoding: str, words: str, cli: Cli
) -> None:
    bag = write(tmp_path / "bag.mcap", [b"{}"], encoding=encoding)
    error = cli.refused("detect", bag, "--target", target, "--topic", TOPIC)
    assert f"{TOPIC} is a {words} message ({PICTURE}) in MCAP" in error
    assert error.count("\n") == 1
    named = f"{words} message ({PICTURE}) in MCAP"
    assert named in cli("info", bag).out
    for other in (["detect", bag, "--target", target], ["review", bag, "--save", "a.rrd"]):
        error = cli.refused(*other)
        assert f"{TOPIC} ({named})" in error
        assert "convert it to ROS 2's CDR" in error


@pytest.mark.parametrize("definition", [b"", b"no definition {", b"int32 a\n"])
def test_what_a_definition_in_the_file_lacks_is_read_by_that_of_ros(
    tmp_path: Path, target: Path, definition: bytes, cli: Cli
) -> None:
    bag = write(tmp_path / "bag.mcap", [SOUND], definition=definition)
    assert cli("detect", bag, "--target", target).out.count("face 0") == 1


def test_messages_that_nobody_counts_have_no_breaks(tmp_path: Path, cli: Cli) -> None:
    file = write(tmp_path / "bag.mcap", [SOUND] * 3)
    assert json.loads(cli("info", file, "--json").out)["keys"][TOPIC[1:]]["sequence_breaks"] == 0


@pytest.mark.parametrize(
    ("form", "data", "way"),
    [
        ("jpeg", b"no picture", "no picture that can be read"),
        ("16UC1; compressedDepth png", bytes(12) + PNG, "name the topic of the camera's pictures"),
        ("h264", b"\0\0\0\1\x67" + bytes(90), "a part of a video; make pictures of it"),
    ],
)
def test_pictures_left_out_for_one_cause_are_said_once_and_counted(
    tmp_path: Path, cli: Cli, form: str, data: bytes, way: str
) -> None:
    payloads = [cdr.encode(Picture(0, "", form, data + bytes(extra))) for extra in range(7)]
    file = write(tmp_path / "b.mcap", payloads)
    (tmp_path / "target.toml").write_text(CHARUCO_TARGET)
    error = cli("detect", file, "--target", tmp_path / "target.toml", status=1).err
    assert "7 pictures left out: " in error
    assert error.count(way) == 1
    assert "(and 6 more like it)" in error


def test_bag_without_messages_or_pictures_is_said_without_a_circle(
    tmp_path: Path, cli: Cli
) -> None:
    target = tmp_path / "target.toml"
    target.write_text(CHARUCO_TARGET)
    empty = tmp_path / "empty.mcap"
    writer = Writer(str(empty))
    writer.start(profile="ros2", library="theirs")
    writer.finish()
    assert "has no messages" in (said := cli.refused("detect", empty, "--target", target))
    assert "trigpoint check" not in said  # which finds it sound
    other = tmp_path / "other.mcap"
    writer = Writer(str(other))
    writer.start(profile="ros2", library="theirs")
    schema = writer.register_schema(ODOMETRY, "ros2msg", cdr.definition(ODOMETRY).encode())
    channel = writer.register_channel("/odom", "cdr", schema)
    writer.add_message(channel, 1, cdr.encode(make_odometry(1)), 1)
    writer.finish()
    assert "no topic in it has pictures" in cli.refused("detect", other, "--target", target)
