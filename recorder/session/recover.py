"""Saves what is sound of a damaged recording into a new file; merges a session's parts."""

import logging
from collections import Counter
from pathlib import Path

from trigpoint.base.errors import OperationError
from trigpoint.base.words import counted
from trigpoint.contract.topics import topic_of
from trigpoint.recorder.mcap.channels import quality_of_service
from trigpoint.recorder.mcap.file import McapIndex, RawMessage, fault_of
from trigpoint.recorder.mcap.rosbag_metadata import PartFacts, write_metadata
from trigpoint.recorder.mcap.writer import McapWriter

from .files import PART, repeated_keys
from .recording import Recording, key_of

_LOG = logging.getLogger(__name__)


def recover(recording: Recording, out: Path) -> dict[str, int]:
    """Write every sound message, in the order of log time, with attachments and metadata, into a
    new file, whose chunks are full ones; return how many messages each key has.

    Messages that cannot be read as what their channel holds are left out, which is logged. Raises
    OperationError where none is left, or the file is there already or cannot be written.
    """
    with McapWriter(out) as writer:
        for name, data in recording.attachments.items():
            writer.attach(name, data, _media_type(name), time_ns=recording.start_ns)
        for name, values in recording.notes.items():
            if name != PART:
                writer.note(name, values)
        channels: dict[tuple[str, str, str], int] = {}
        for number, part in enumerate(recording.parts):
            _copy(recording, part, writer, channels, repeated_keys(part) if number else set())
    if not writer.counts:
        out.unlink()
        raise OperationError(f"{recording.path}: no message of it can be read; nothing is written")
    facts = PartFacts(out.name, writer.times_ns, writer.counts, writer.types)
    try:
        write_metadata(out.parent, [facts])
    except OSError as reason:
        raise OperationError(f"{out.parent}: metadata.yaml: {reason.strerror}") from None
    return writer.counts


def _copy(
    recording: Recording,
    part: McapIndex,
    writer: McapWriter,
    defined: dict[tuple[str, str, str], int],
    repeated: set[str],
) -> None:
    """Copy a part; `defined`: the channels written so far, by key, type and encoding."""
    channels = {number for number in part.channels if _counted(part, number)}
    numbers = {number: _defined(part, number, writer, defined) for number in channels}
    keys = {number: key_of(part, number) for number in channels}
    faults: Counter[tuple[str, str]] = Counter()
    for message in recording.messages(part, channels):
        channel = part.channels[message.channel]
        if fault := fault_of(channel, part.schemas.get(channel.schema_id), message.payload):
            faults[keys[message.channel], fault] += 1
            continue
        if repeated and keys[message.channel] in repeated:
            repeated.discard(keys[message.channel])
            continue
        writer.append([_row(message, numbers[message.channel])])
    for (key, fault), count in faults.items():
        words = counted(count, "message")
        _LOG.warning("%s: left out: %s of %s (each %s)", part.path, words, key, fault)


def _counted(part: McapIndex, channel: int) -> bool:
    return any(channel in span.counts for span in part.chunks)


def _row(message: RawMessage, channel: int) -> tuple[int, int, int, bytes]:
    return message.log_ns, message.published_ns, channel, message.payload


def _defined(
    part: McapIndex, number: int, writer: McapWriter, defined: dict[tuple[str, str, str], int]
) -> int:
    channel = part.channels[number]
    schema = part.schemas.get(channel.schema_id)
    name, form, text = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    key, encoding = key_of(part, number), channel.message_encoding
    if (key, name, encoding) not in defined:
        metadata = dict(channel.metadata)
        if not metadata and (topic := topic_of(key)):
            metadata["offered_qos_profiles"] = quality_of_service(topic)
        new = writer.define(key, name, form, text, metadata, encoding=encoding)
        defined[key, name, encoding] = new
    return defined[key, name, encoding]


def _media_type(name: str) -> str:
    kinds = {".toml": "application/toml", ".json": "application/json", ".yaml": "application/yaml"}
    return kinds.get(Path(name).suffix, "application/octet-stream")
