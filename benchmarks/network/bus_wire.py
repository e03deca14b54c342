"""What the two processes of the bus benchmark agree on."""

import json
import socket
from dataclasses import dataclass

import zenoh

WARM_UP = 50
_STAMP_BYTES = 8


@dataclass(frozen=True, slots=True)
class Wire:
    """`ours`, `bare`: endpoints that the receiving process listens on; `topic`: its name."""

    ours: str
    bare: str
    topic: str
    size: int
    count: int
    pause_s: float

    our_key = "lab/camera/ours"
    bare_key = "lab/camera/bare"

    @property
    def arguments(self) -> list[str]:
        """For the sender's command line."""
        numbers = (str(self.size), str(self.count), str(self.pause_s))
        return [self.ours, self.bare, self.topic, *numbers]

    @classmethod
    def of(cls, arguments: list[str]) -> "Wire":
        """The reverse of `arguments`."""
        ours, bare, topic, size, count, pause_s = arguments
        return cls(ours, bare, topic, int(size), int(count), float(pause_s))


def stamped(now_ns: int, size: int) -> bytes:
    """A payload that begins with the time at which it is sent."""
    return now_ns.to_bytes(_STAMP_BYTES, "little").ljust(size, b"\0")


def sent_ns(payload: bytes) -> int:
    """When a payload was sent."""
    return int.from_bytes(payload[:_STAMP_BYTES], "little")


def free_endpoint() -> str:
    """An endpoint on loopback that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def open_bare(*, listen: str | None = None, connect: str | None = None) -> zenoh.Session:
    """A session with Zenoh's defaults, kept on loopback."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([listen or "tcp/127.0.0.1:0"]))
    config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
    return zenoh.open(config)
