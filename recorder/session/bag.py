"""Anybody's bag as input: MCAP, rosbag2 and ROS 1 files, read with the definitions that they carry.

Our own sessions are read by `recording`; this knows no key of the contract, only topics and types.
"""

import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from trigpoint.base.errors import MessageError, RecordingError
from trigpoint.contract.cdr_codecs import CODECS
from trigpoint.contract.cdr_ros import stamp_of
from trigpoint.contract.messages import (
    CAMERA_INFO,
    ODOMETRY,
    PICTURE,
    RAW_IMAGE,
    SIGHTINGS,
    Message,
)
from trigpoint.recorder.mcap.file import McapIndex, is_of_ros2
from trigpoint.recorder.mcap.index import read_index
from trigpoint.recorder.mcap.rosbag_files import STORE, STREAMED, Raw, RosbagFiles, decoded

from .files import session_files
from .recording import Recording

PICTURES = (RAW_IMAGE, PICTURE)
READ = (*PICTURES, CAMERA_INFO, ODOMETRY, SIGHTINGS)
"""The types that have a use as input."""
Refuse = Callable[[str, int, MessageError], None]
"""Told a topic, the log time and what is wrong."""
_LOG = logging.getLogger(__name__)
_BY_TYPE = {codec.type_name: codec for codec in CODECS}


class RawImage(Struct, frozen=True):
    """A picture as sensor_msgs/msg/Image has it: `data` (n,) uint8, rows of `step` bytes if that is
    true."""

    stamp_ns: int
    encoding: str
    is_bigendian: bool
    width: int
    height: int
    step: int
    data: np.ndarray


class BagMessage(Struct, frozen=True):
    """One message; `log_ns`: when it was recorded."""

    topic: str
    log_ns: int
    message: Message | RawImage


class Bag:
    """An opened bag. Every method raises RecordingError where it cannot be read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        files = session_files(path, takes_several=True)
        is_foreign = any(file.is_dir() or file.suffix in STREAMED for file in files)
        self._source = RosbagFiles(path) if is_foreign else _McapFiles(path, files)
        self.topics = {topic: _most_useful(kinds) for topic, kinds in self._source.kinds.items()}
        """Type by topic: of several, the one of use that most of its messages have."""

    @property
    def known(self) -> str:
        """All topics with their types, for people."""
        return ", ".join(f"{name} ({kind})" for name, kind in sorted(self.topics.items()))

    @property
    def is_foreign(self) -> bool:
        """Whether none of its messages is of ROS 2."""
        return not any(map(is_of_ros2, self.topics.values()))

    def pictures(self) -> list[str]:
        """The topics with pictures."""
        return [topic for topic, kind in self.topics.items() if kind in PICTURES]

    def messages(self, topics: Collection[str], refuse: Refuse) -> Iterator[BagMessage]:
        """The messages of these topics, in the order of recording; one that is not sound is left
        out, and `refuse` told. Raises RecordingError for a topic that is not there or of no use."""
        for topic in topics:
            self._check(topic)
        for topic, kind, log_ns, decode in self._source.messages(topics):
            try:
                if kind != self.topics[topic]:
                    raise MessageError(f"is a {kind}, not a {self.topics[topic]}")
                message = _message(kind, decode())
            except MessageError as reason:
                refuse(topic, log_ns, reason)
                continue
            yield BagMessage(topic, log_ns, message)

    def _check(self, topic: str) -> None:
        kind = self.topics.get(topic)
        if kind is None:
            raise RecordingError(f"{self._path}: there is no topic {topic}; it has {self.known}")
        if kind not in READ:
            give = (
                "give pictures, camera_info or odometry"
                if is_of_ros2(kind)
                else "convert it to ROS 2's CDR"
            )
            raise RecordingError(f"{self._path}: {topic} is a {kind}; {give}")


class _McapFiles:
    """MCAP files, whatever is damaged or left out in them."""

    def __init__(self, path: Path, files: Sequence[Path]) -> None:
        self._parts = [Recording([read_index(file)]) for file in files]
        self.kinds: dict[str, Counter[str]] = {}
        """By topic, how many messages each of its types has."""
        for recording in self._parts:
            (part,) = recording.parts
            for number, channel in part.channels.items():
                count = sum(span.counts.get(number, 0) for span in part.chunks)
                kinds = self.kinds.setdefault(channel.topic, Counter())
                kinds[part.type_of(number)] += count
        if not self.kinds:
            problems = "; ".join(filter(None, (recording.problem for recording in self._parts)))
            why = f"nothing in it can be read ({problems}); `trigpoint check` says more"
            raise RecordingError(f"{path}: {why if problems else 'it has no messages'}")

    def messages(self, topics: Collection[str]) -> Iterator[Raw]:
        for recording in self._parts:
            if recording.problem:
                _LOG.warning("%s: not whole: %s", recording.path, recording.problem)
            (part,) = recording.parts
            wanted = {number for number, c in part.channels.items() if c.topic in topics}
            decoders = {number: _decoder(part, number) for number in wanted}
            for message in recording.messages(part, wanted):
                number = message.channel
                kind = part.type_of(number)
                decode = partial(decoded, decoders[number], message.payload, kind)
                yield part.channels[number].topic, kind, message.log_ns, decode


def _most_useful(counts: Mapping[str, int]) -> str:
    return max(counts, key=lambda kind: (kind in READ, counts[kind]))


def _decoder(part: McapIndex, number: int) -> Callable[[bytes], Any]:
    """Reads a channel's messages by the definition that the file has of them, or by ROS's."""
    schema = part.schemas.get(part.channels[number].schema_id)
    name = schema.name if schema else ""
    store = get_typestore(Stores.EMPTY)
    try:
        text = schema.data.decode() if schema else ""
        types = get_types_from_idl if schema and schema.encoding == "ros2idl" else None
        store.register(types(text) if types else get_types_from_msg(text, name))
        if not _fields(STORE, name) <= _fields(store, name):
            store = STORE  # recorders write an empty one where they do not find it
    except Exception:  # noqa: BLE001 - rosbags raises whatever a definition leads it to
        store = STORE
    return lambda payload: store.deserialize_cdr(payload, name)


def _fields(store: Typestore, name: str) -> set[str]:
    """The names of a type's fields in small letters, as not all of ROS 1's are."""
    _, fields = store.fielddefs.get(name, ([], []))
    return {field.lower() for field, _ in fields}


def _message(type_name: str, found: Any) -> Message | RawImage:
    if type_name == RAW_IMAGE:
        return RawImage(
            stamp_of(found.header),
            found.encoding,
            bool(found.is_bigendian),
            found.width,
            found.height,
            found.step,
            np.asarray(found.data, dtype=np.uint8),
        )
    if type_name == CAMERA_INFO and not hasattr(found, "k"):  # of ROS 1
        found = _Lowered(found)
    return _BY_TYPE[type_name].from_ros(found)


class _Lowered:
    """A ROS 1 message whose matrices have capital names."""

    def __init__(self, found: Any) -> None:
        self._found = found

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found, name.upper() if len(name) == 1 else name)
