"""The messages that fusion sends."""

from dataclasses import dataclass

from trigpoint.messages import Message
from trigpoint.topics import Topic


@dataclass(frozen=True, slots=True)
class Output:
    """A message to send: `node` is the camera or robot of its key."""

    topic: Topic
    node: str
    message: Message
    attachment: bytes = b""
