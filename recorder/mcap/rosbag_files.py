"""What rosbags opens: ROS 1's bags, and rosbag2's in SQLite or packed message by message."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from trigpoint.base.errors import MessageError, RecordingError, TrigpointError
from trigpoint.base.words import counted

from .rosbag_metadata import BAGS
from .rosbag_metadata import FILE as METADATA
from .writer import McapWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
Raw = tuple[str, str, int, Callable[[], Any]]
"""A message's topic, type and log time, and how to decode it."""
STREAMED = (".db3", ".bag")
"""Files of these are read as they are, rather than made MCAP first."""
_ENCODINGS = {
    MessageDefinitionFormat.MSG: "ros2msg",
    MessageDefinitionFormat.IDL: "ros2idl",
    MessageDefinitionFormat.NONE: "",
}


class RosbagFiles:
    """One such bag. Every method raises RecordingError where it cannot be read."""

    def __init__(self, path: Path) -> None:
        is_one = not path.is_dir() or (path / METADATA).exists()
        self._path = path
        self._files = (
            [path] if is_one else sorted(file for file in path.iterdir() if file.suffix in BAGS)
        )
        self.kinds: dict[str, Counter[str]] = {}
        with self._opened() as reader:
            for connection in reader.connections:
                kinds = self.kinds.setdefault(connection.topic, Counter())
                kinds[connection.msgtype] += connection.msgcount

    def messages(self, topics: Collection[str]) -> Iterator[Raw]:
        with self._opened() as reader:
            wanted = [c for c in reader.connections if c.topic in topics]
            for connection, log_ns, data in reader.messages(wanted):
                kind = connection.msgtype
                decode = partial(decoded, partial(reader.deserialize, typ=kind), data, kind)
                yield connection.topic, kind, log_ns, decode

    def save(self, file: Path) -> None:
        """Write a rosbag2 as MCAP, with the definitions that it carries, else with ROS's; raises
        OperationError where the disk does not take it."""
        writer = McapWriter(file)
        with self._opened() as reader:
            numbers = {c.id: _defined(c, writer) for c in reader.connections}
            for connection, log_ns, data in reader.messages():
                writer.append([(log_ns, log_ns, numbers[connection.id], bytes(data))])
            writer.finish()

    @contextmanager
    def _opened(self) -> Iterator[AnyReader]:
        try:
            with AnyReader(self._files, default_typestore=STORE) as reader:
                yield reader
        except (TrigpointError, GeneratorExit):
            raise
        except Exception as reason:  # noqa: BLE001 - rosbags raises whatever a bag leads it to
            told = " ".join(str(reason).split()) or type(reason).__name__
            is_old = any(file.suffix == ".bag" for file in self._files)
            way = "mend it: rosbag reindex" if is_old else "see what `ros2 bag info` says of it"
            raise RecordingError(
                f"{self._path}: this bag cannot be read ({told}); copy it again, or {way}"
            ) from None


def _defined(connection: Connection, writer: McapWriter) -> int:
    form, text = connection.msgdef.format, connection.msgdef.data
    kind, key = connection.msgtype, connection.topic.removeprefix("/")
    if form is MessageDefinitionFormat.NONE and kind in STORE.types:
        form, text = MessageDefinitionFormat.MSG, STORE.generate_msgdef(kind, ros_version=2)[0]
    return writer.define(key, kind, _ENCODINGS[form], text.encode(), {})


def decoded(decode: Callable[[bytes], Any], data: bytes, kind: str) -> Any:
    """A message of a type; raise MessageError where the bytes are none."""
    try:
        return decode(data)
    except Exception:  # noqa: BLE001 - rosbags raises whatever a message leads it to
        raise MessageError(f"its {counted(len(data), 'byte')} are no whole {kind}") from None
