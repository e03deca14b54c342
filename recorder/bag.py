"""Anybody's bag as input: MCAP, rosbag2 and ROS 1 files, read with the definitions that they carry.

Our own sessions are read by `recording`; this knows no key of the contract, only topics and types.
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from trigpoint.cdr_codecs import CODECS
from trigpoint.errors import MessageError, RecordingError
from trigpoint.messages import CAMERA_INFO, ODOMETRY, PICTURE, SIGHTINGS, Message

IMAGE = "sensor_msgs/msg/Image"
PICTURES = (IMAGE, PICTURE)
READ = (*PICTURES, CAMERA_INFO, ODOMETRY, SIGHTINGS)
"""The types that have a use as input."""
_FILES = (".mcap", ".db3", ".bag")
Refuse = Callable[[str, str, MessageError], None]
_BY_TYPE = {codec.type_name: codec for codec in CODECS}


@dataclass(frozen=True, slots=True)
class RawImage:
    """A picture as sensor_msgs/msg/Image has it; `data`: (height, step) uint8 rows."""

    stamp_ns: int
    encoding: str
    is_bigendian: bool
    width: int
    height: int
    data: np.ndarray


@dataclass(frozen=True, slots=True)
class BagMessage:
    """One message; `log_ns`: when it was recorded."""

    topic: str
    log_ns: int
    message: Message | RawImage


def is_bag(path: Path) -> bool:
    """Whether a path is a bag's file, or a folder with one."""
    if path.is_dir():
        return any(file.suffix in _FILES for file in path.iterdir())
    return path.suffix in _FILES


class Bag:
    """An opened bag. Every method raises RecordingError where it cannot be read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with _reading(path), AnyReader(_files(path), default_typestore=_STORE) as reader:
            self.topics = {c.topic: c.msgtype for c in reader.connections}
        """Type by topic."""

    def pictures(self) -> list[str]:
        """The topics with pictures."""
        return [topic for topic, kind in self.topics.items() if kind in PICTURES]

    def messages(
        self, topics: Collection[str], refuse: Refuse = lambda *_: None
    ) -> Iterator[BagMessage]:
        """The messages of these topics, in the order of recording; one that is not sound is left
        out, and `refuse` called with its topic, type and what is wrong. Raises RecordingError for a
        topic that is not there or of no use."""
        for topic in topics:
            self._check(topic)
        with (
            _reading(self._path),
            AnyReader(_files(self._path), default_typestore=_STORE) as reader,
        ):
            wanted = [c for c in reader.connections if c.topic in topics]
            for connection, log_ns, data in reader.messages(wanted):
                try:
                    found = reader.deserialize(data, connection.msgtype)
                    message = _message(connection.msgtype, found)
                except MessageError as reason:
                    refuse(connection.topic, connection.msgtype, reason)
                    continue
                yield BagMessage(connection.topic, log_ns, message)

    def _check(self, topic: str) -> None:
        kind = self.topics.get(topic)
        if kind is None:
            known = ", ".join(f"{name} ({kind})" for name, kind in sorted(self.topics.items()))
            raise RecordingError(f"{self._path}: there is no topic {topic}; it has {known}")
        if kind not in READ:
            raise RecordingError(
                f"{self._path}: {topic} is a {kind}; give pictures, camera_info or odometry"
            )


_STORE = get_typestore(Stores.ROS2_JAZZY)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except (RecordingError, GeneratorExit):
        raise
    except Exception as reason:  # noqa: BLE001 - rosbags raises whatever a bag leads it to
        told = " ".join(str(reason).split()) or type(reason).__name__
        raise RecordingError(
            f"{path}: this bag cannot be read ({told}); `trigpoint check` says what is wrong, "
            "`trigpoint recover` saves what is sound"
        ) from None


def _files(path: Path) -> list[Path]:
    """What rosbags opens: a folder with metadata.yaml, or files."""
    if not path.is_dir() or (path / "metadata.yaml").exists():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix in _FILES)


def _message(type_name: str, found: Any) -> Message | RawImage:
    if type_name == IMAGE:
        stamp_ns = found.header.stamp.sec * 10**9 + found.header.stamp.nanosec
        rows = np.asarray(found.data, dtype=np.uint8)
        if found.height <= 0 or rows.size < found.height * found.step:
            raise MessageError("a picture is shorter than it says")
        rows = rows[: found.height * found.step].reshape(found.height, found.step)
        return RawImage(
            stamp_ns,
            found.encoding,
            bool(found.is_bigendian),
            found.width,
            found.height,
            rows,
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
