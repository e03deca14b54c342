"""Bags with pictures in which a message, the file or its parts are not as they should be."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import IndexType, Writer
from msgspec import Struct
from msgspec.structs import replace
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from trigpoint.contract import cdr

from .case import LEFT_OUT, Case, Kind
from .pictures import jpeg, png
from .targets import HEIGHT, WIDTH, board, shots, write_target

STORE = get_typestore(Stores.ROS2_JAZZY)
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
TOPIC = "/c1/image_raw/compressed"
BEGIN_NS, PERIOD_NS = 1_700_000_000_000_000_000, 200_000_000
_OWN = "trigpoint_msgs/"


class Message(Struct, frozen=True):
    """One message of a bag, as bytes."""

    topic: str
    kind: str
    log_ns: int
    payload: bytes


def write_mcap(
    path: Path,
    messages: Sequence[Message],
    *,
    encodings: tuple[str, str] = ("cdr", "ros2msg"),
    **settings: Any,
) -> Path:
    """A file of the bare library; `encodings` of messages and schemas; `settings`: its writer's."""
    with path.open("wb") as file:
        writer = Writer(file, **settings)
        writer.start("ros2" if encodings[0] == "cdr" else "")
        channels: dict[tuple[str, str], int] = {}
        for one in messages:
            if (one.topic, one.kind) not in channels:
                schema = writer.register_schema(one.kind, encodings[1], _definition(one.kind))
                channels[one.topic, one.kind] = writer.register_channel(
                    one.topic, encodings[0], schema
                )
            writer.add_message(channels[one.topic, one.kind], one.log_ns, one.payload, one.log_ns)
        writer.finish()
    return path


def _definition(kind: str) -> bytes:
    if kind.startswith(_OWN):
        return cdr.definition(kind).encode()
    return STORE.generate_msgdef(kind, ros_version=2)[0].encode()


def header(stamp_ns: int) -> Any:
    time = STORE.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return STORE.types["std_msgs/msg/Header"](stamp=time, frame_id="c1/optical")


def compressed(data: bytes, number: int) -> Message:
    """A picture's file as a message."""
    stamp_ns = BEGIN_NS + number * PERIOD_NS
    array = np.frombuffer(data, np.uint8)
    found = STORE.types[COMPRESSED](header=header(stamp_ns), format="jpeg", data=array)
    return Message(TOPIC, COMPRESSED, stamp_ns, bytes(STORE.serialize_cdr(found, COMPRESSED)))


def _bag(face: Any, random: np.random.Generator) -> list[Message]:
    count = int(random.integers(4, 8))
    return [compressed(jpeg(one), k) for k, one in enumerate(shots(face, random, count))]


def _detect(
    folder: Path, random: np.random.Generator, spoil: Callable[[list[Message], int], None]
) -> tuple[tuple[str | Path, ...], int]:
    """The words for a bag whose message of a drawn number was spoilt, and how many are sound."""
    face = board(random)
    messages = _bag(face, random)
    spoil(messages, int(random.integers(len(messages))))
    bag = write_mcap(folder / "bag.mcap", messages)
    words = ("detect", bag, "--json", "--topic", TOPIC, "--target", write_target(folder, face))
    return words, len(messages) - 1


def cut_message(folder: Path, random: np.random.Generator) -> Case:
    """Empty, or cut within its header or its data."""

    def spoil(messages: list[Message], at: int) -> None:
        payload = messages[at].payload
        end = int(random.choice([0, 3, 10, 40, len(payload) // 2]))
        messages[at] = replace(messages[at], payload=payload[:end])

    words, seen = _detect(folder, random, spoil)
    return Case(words, says=(LEFT_OUT, "1 "), seen=seen)


def broken_picture(folder: Path, random: np.random.Generator) -> Case:
    def spoil(messages: list[Message], at: int) -> None:
        data = jpeg(shots(board(random), random, 1)[0])
        broken = [b"", random.bytes(2000), data[: len(data) // 2], png_of_nothing()]
        messages[at] = compressed(broken[random.integers(len(broken))], at)

    words, seen = _detect(folder, random, spoil)
    return Case(words, says=(LEFT_OUT, TOPIC), seen=seen)


def png_of_nothing() -> bytes:
    """A PNG that ends behind its header."""
    return png(np.zeros((HEIGHT, WIDTH), np.uint8))[:30]


def second_type(folder: Path, random: np.random.Generator) -> Case:
    kind = str(random.choice(["std_msgs/msg/Header", "sensor_msgs/msg/CameraInfo"]))

    def spoil(messages: list[Message], at: int) -> None:
        payload = bytes(STORE.serialize_cdr(header(messages[at].log_ns), "std_msgs/msg/Header"))
        messages[at] = replace(messages[at], kind=kind, payload=payload)

    words, seen = _detect(folder, random, spoil)
    return Case(words, says=(TOPIC, kind.rpartition("/")[2]), seen=seen)


def wrong_step(folder: Path, random: np.random.Generator) -> Case:
    """Rows are as long as the picture is wide, and the message says otherwise."""
    face, (encoding, channels) = (
        board(random),
        (("mono8", 1), ("rgb8", 3), ("bgra8", 4))[random.integers(3)],
    )
    step = int(random.choice([0, 4, WIDTH // 2, WIDTH + 1 if channels == 1 else WIDTH]))
    messages = []
    for number, picture in enumerate(shots(face, random, 3)):
        data = np.repeat(picture.reshape(-1), channels)
        stamp_ns = BEGIN_NS + number * PERIOD_NS
        found = STORE.types[IMAGE](header(stamp_ns), HEIGHT, WIDTH, encoding, 0, step, data)
        payload = bytes(STORE.serialize_cdr(found, IMAGE))
        messages.append(Message("/c1/image_raw", IMAGE, stamp_ns, payload))
    bag = write_mcap(folder / "bag.mcap", messages)
    return Case(("detect", bag, "--json", "--target", write_target(folder, face)), seen=3)


def without_index(folder: Path, random: np.random.Generator) -> Case:
    """Without message index, chunk index, summary, or chunks: all are allowed."""
    settings: tuple[dict[str, Any], ...] = (
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.MESSAGE},
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False},
        {"use_chunking": False},
    )
    face = board(random)
    messages = _bag(face, random)
    chosen = settings[random.integers(len(settings))]
    bag = write_mcap(folder / "bag.mcap", messages, chunk_size=50_000, **chosen)
    count = rf"\b{len(messages)}\b"
    match random.integers(3):
        case 0:
            return Case(("info", bag), says=(TOPIC.strip("/"), count))
        case 1:
            return Case(("recover", bag, "--out", folder / "sound.mcap"), says=(count,))
        case _:
            words = ("detect", bag, "--json", "--target", write_target(folder, face))
            return Case(words, seen=len(messages))


def in_parts(folder: Path, random: np.random.Generator) -> Case:
    face = board(random)
    messages = _bag(face, random)
    at = int(random.integers(1, len(messages)))
    bag = folder / "bag"
    bag.mkdir()
    for number, part in enumerate((messages[:at], messages[at:])):
        write_mcap(bag / f"bag_{number}.mcap", part)
    (bag / "metadata.yaml").write_text(_metadata(len(messages)), encoding="utf-8")
    return _any_command(folder, bag, face, len(messages), random)


def _metadata(count: int) -> str:
    """Of a bag of two parts, as rosbag2 writes it."""
    return f"""\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration: {{nanoseconds: {(count - 1) * PERIOD_NS}}}
  starting_time: {{nanoseconds_since_epoch: {BEGIN_NS}}}
  message_count: {count}
  topics_with_message_count:
    - topic_metadata:
        name: {TOPIC}
        type: {COMPRESSED}
        serialization_format: cdr
        offered_qos_profiles: []
        type_description_hash: {STORE.hash_rihs01(COMPRESSED)}
      message_count: {count}
  compression_format: ""
  compression_mode: ""
  relative_file_paths: [bag_0.mcap, bag_1.mcap]
  files: []
  custom_data: {{}}
  ros_distro: jazzy
"""


def in_compression(folder: Path, random: np.random.Generator) -> Case:
    """A whole file or each message, in either storage."""
    face = board(random)
    messages = _bag(face, random)
    mode = (CompressionMode.FILE, CompressionMode.MESSAGE)[random.integers(2)]
    plugin = (StoragePlugin.MCAP, StoragePlugin.SQLITE3)[random.integers(2)]
    if plugin is StoragePlugin.MCAP:
        mode = CompressionMode.FILE  # its chunks are compressed by the storage itself
    writer = BagWriter(folder / "bag", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, COMPRESSED, typestore=STORE)
        for one in messages:
            writer.write(connection, one.log_ns, one.payload)
    return _any_command(folder, folder / "bag", face, len(messages), random)


def _any_command(
    folder: Path, bag: Path, face: Any, count: int, random: np.random.Generator
) -> Case:
    if random.integers(2):
        return Case(("info", bag), says=(TOPIC.strip("/"), rf"\b{count}\b"))
    return Case(("detect", bag, "--json", "--target", write_target(folder, face)), seen=count)


def other_encoding(folder: Path, random: np.random.Generator) -> Case:
    """ROS 1 messages and JSON in an MCAP are named as such."""
    face = board(random)
    *encodings, said = [("ros1", "ros1msg", r"ROS ?1"), ("json", "jsonschema", "JSON")][
        random.integers(2)
    ]
    messages = [replace(one, payload=b'{"data": ""}') for one in _bag(face, random)]
    bag = write_mcap(folder / "bag.mcap", messages, encodings=(encodings[0], encodings[1]))
    words = ("detect", bag, "--topic", TOPIC, "--target", write_target(folder, face))
    return Case(words, (1, 2), (said,))


BAGS: Mapping[str, Kind] = {
    "an empty or cut message": cut_message,
    "a broken picture in a bag": broken_picture,
    "a second type on a topic": second_type,
    "a step that is wrong": wrong_step,
    "MCAP without an index": without_index,
    "a bag in parts": in_parts,
    "a compressed bag": in_compression,
    "ROS 1 or JSON in MCAP": other_encoding,
}
