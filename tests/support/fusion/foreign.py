"""A session as the bag of somebody who has other topics."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer

from trigpoint.contract.cdr_ros import store
from trigpoint.contract.messages import ODOMETRY
from trigpoint.recorder.session.recording import open_recording

Change = Callable[[int, Any], None]
"""Changes a message, of which it gets the number too."""


def as_foreign(
    recorded: Path,
    folder: Path,
    change: Change = lambda _number, _message: None,
    *,
    kind: str = ODOMETRY,
    plugin: StoragePlugin = StoragePlugin.MCAP,
) -> tuple[object, ...]:
    """The bag, and the words that say whose its topics are; the site file is beside it. All its
    messages of one type are changed."""
    recording, connections, number = open_recording(recorded), dict[str, Any](), 0
    with Writer(folder / "bag", version=9, storage_plugin=plugin) as writer:
        for sample in recording.samples():
            name, data = sample.topic.type_name, sample.payload
            topic = f"/{sample.key.split('/')[2]}/{name.rpartition('/')[2]}"
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store())
            if name == kind:
                message = store().deserialize_cdr(data, name)
                change(number, message)
                number += 1
                data = bytes(store().serialize_cdr(message, name))
            writer.write(connections[topic], sample.log_ns, data)
    for name, data in recording.attachments.items():
        (folder / name).write_bytes(data)
    roles = (word for t in connections for word in ("--topic", f"{t.split('/')[1]}={t}"))
    return folder / "bag", *roles
