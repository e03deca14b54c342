"""The written file, as independent readers see it."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from rerun.chunk import McapReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from trigpoint.base.errors import OperationError
from trigpoint.contract import cdr
from trigpoint.contract.messages import SIGHTINGS
from trigpoint.contract.topics import TOPICS
from trigpoint.recorder.mcap.writer import McapWriter, quality_of_service


def test_the_mcap_library_reads_it_back(session_file: Path, story: list) -> None:
    with session_file.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        read = sorted(
            (channel.topic, schema.name, schema.encoding, channel.message_encoding, message.data)
            for schema, channel, message in reader.iter_messages()
            if schema is not None
        )
        names = {attachment.name for attachment in reader.iter_attachments()}
    assert read == sorted(
        ("/" + one.key, one.topic.type_name, "ros2msg", "cdr", one.payload) for one in story
    )
    assert names == {"site.toml", "target.toml"}


def test_checksums_are_written_and_hold(session_file: Path) -> None:
    with session_file.open("rb") as file:
        records = StreamReader(file, emit_chunks=True).records
        checksums = [r.uncompressed_crc for r in records if isinstance(r, Chunk)]
    assert checksums
    assert all(checksums)
    with session_file.open("rb") as file:
        assert list(StreamReader(file, validate_crcs=True).records)


def test_rosbags_reads_it_with_the_definitions_in_the_file(session_file: Path, story: list) -> None:
    store = get_typestore(Stores.EMPTY)  # knows no message: all that it needs is in the file
    with AnyReader([session_file], default_typestore=store) as reader:
        connections = {c.topic: c.msgtype for c in reader.connections}
        seen = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
            if connection.msgtype == SIGHTINGS
        ]
    assert connections == {"/" + one.key: one.topic.type_name for one in story}
    expected = [one for one in story if one.topic.type_name == SIGHTINGS]
    faces = sum(len(one.message.faces) for one in expected)
    assert len(seen) == len(expected)
    assert sum(len(message.faces) for message in seen) == faces  # pyright: ignore[reportAttributeAccessIssue] - made at run time


def test_channels_carry_what_rosbag2_looks_for(session_file: Path) -> None:
    with session_file.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        name = summary.schemas[channel.schema_id].name
        assert channel.metadata["topic_type_hash"] == cdr.type_hash(name)
        (profile,) = YAML(typ="safe").load(channel.metadata["offered_qos_profiles"])
        assert profile["history"] == "keep_last"
        assert profile["depth"] >= 1


def test_reruns_own_loader_reads_it(session_file: Path) -> None:
    entities = {chunk.entity_path for chunk in McapReader(session_file).stream()}
    assert "/lab/camera/c1/image/compressed" in entities
    assert "/lab/robot/r1/odom" in entities


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_delivery_is_written_as_rosbag2_reads_it(topic) -> None:
    text = quality_of_service(topic)
    wanted = "reliable" if topic.delivery.is_reliable else "best_effort"
    assert f"  reliability: {wanted}\n" in text
    keeps = ("camera_info", "camera_pose", "coverage", "coverage_grid", "tf_static")
    assert ("transient_local" in text) == (topic.name in keeps)


def test_a_file_that_is_there_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "session.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(OperationError, match="is there already"):
        McapWriter(path)
    assert path.read_bytes() == b"precious"


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OperationError, match="cannot be created"):
        McapWriter(tmp_path / "file" / "session.mcap")
