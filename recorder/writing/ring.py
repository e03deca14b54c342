"""The last seconds of a site in memory, to be saved when something has happened."""

import threading
import uuid
from collections import deque
from collections.abc import Collection
from operator import attrgetter
from pathlib import Path

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Diagnostics
from trigpoint.contract.topics import Delivery, Topic
from trigpoint.recorder.mcap.chunk import Compression
from trigpoint.recorder.mcap.rosbag_metadata import PartFacts, write_metadata
from trigpoint.recorder.mcap.writer import Message

from .part import AttachedFile, Part

_MOVED = "left_out.camera_moved.total"  # in fusion's diagnostics


class Ring:
    """Keeps what came in the last `seconds`, at most `capacity` bytes: the oldest goes first. Of
    what late joiners are given, the last value of each key stays. Any thread may call it."""

    def __init__(self, seconds: float, *, capacity: float) -> None:
        self._span_ns, self._capacity = to_ns(seconds), capacity
        self._messages: deque[Message] = deque()
        self._bytes = 0
        self._latched: dict[str, Message] = {}
        self._lock = threading.Lock()

    def write(
        self,
        topic: Topic,
        key: str,
        payload: bytes,
        *,
        log_ns: int,
        published_ns: int,
        attachment: bytes = b"",
    ) -> bool:
        """Keep one message; always true, as nothing is lost that was to be kept."""
        message = Message(log_ns, published_ns, topic, key, payload, attachment)
        with self._lock:
            self._messages.append(message)
            self._bytes += len(payload)
            while self._messages and self._is_over(self._messages[0], log_ns):
                self._drop()
        return True

    @property
    def depth(self) -> int:
        """How many messages are held."""
        return len(self._messages)

    def save(
        self, path: Path, files: Collection[AttachedFile], compression: Compression
    ) -> dict[str, int]:
        """Write what is held as a session; return how many messages of each key. Raises
        OperationError where that cannot be done."""
        with self._lock:
            messages, latched = list(self._messages), dict(self._latched)
        messages.sort(key=attrgetter("log_ns"))
        start_ns = messages[0].log_ns if messages else 0
        part = Part(
            path,
            session=uuid.uuid4().hex,
            number=1,
            files=files,
            latched={key: m._replace(log_ns=start_ns) for key, m in latched.items()},
            start_ns=start_ns,
            compression=compression,
        )
        part.add(messages)
        part.finish({}, [])
        counts = part.writer.counts
        write_metadata(path.parent, [PartFacts(path.name, part.writer.times_ns, counts)])
        return counts

    def _is_over(self, oldest: Message, now_ns: int) -> bool:
        return oldest.log_ns < now_ns - self._span_ns or self._bytes > self._capacity

    def _drop(self) -> None:
        oldest = self._messages.popleft()
        self._bytes -= len(oldest.payload)
        if oldest.topic.delivery is Delivery.LAST_VALUE:
            self._latched[oldest.key] = oldest


class MovedCameras:
    """Hears of cameras that were moved from fusion, which decides it and counts them."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def are_more(self, diagnostics: Diagnostics) -> bool:
        """Take a node's diagnostics; return whether it counts more than the time before."""
        are_more = False
        for status in diagnostics.statuses:
            if not status.name.startswith("fusion/"):
                continue
            said = status.values.get(_MOVED, "")
            count = int(said) if said.isdecimal() else 0  # none yet, or no fusion of ours
            are_more |= count > self._counts.get(status.name, count)
            self._counts[status.name] = count
        return are_more
