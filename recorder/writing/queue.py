"""What waits for the disk: two bounded queues, so that pictures never push out what is small."""

import threading
from collections import Counter, deque

from trigpoint.contract.topics import IMAGE
from trigpoint.recorder.mcap.writer import Message


class Lane:
    """One queue of `capacity` bytes."""

    __slots__ = ("bytes", "capacity", "taken_bytes", "waiting")

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.waiting: deque[Message] = deque()
        self.bytes = 0
        """Of what waits and of what was taken but is not in the file yet."""
        self.taken_bytes = 0


class SinkQueue:
    """Pictures wait in a lane of their own, everything else in another; a full one refuses what
    comes, which is counted by key. Every method may be called from any thread."""

    def __init__(self, capacity: int) -> None:
        """`capacity`: of each lane, bytes."""
        self._pictures, self._others = Lane(capacity), Lane(capacity)
        self._urgent_bytes = capacity // 16
        self.is_urgent = threading.Event()
        """So much waits that whoever takes it should not wait."""
        self._lock = threading.Lock()
        self._lost: Counter[str] = Counter()

    def put(self, message: Message) -> bool:
        """Append; False where its lane is full and it is lost."""
        lane = self._pictures if message.topic is IMAGE else self._others
        with self._lock:
            held = lane.bytes + len(message.payload)
            if held > lane.capacity:
                self._lost[message.key] += 1
                return False
            lane.bytes = held
            lane.waiting.append(message)
        if held > self._urgent_bytes:
            self.is_urgent.set()
        return True

    def take(self) -> list[Message]:
        """Everything that waits. It counts against the lanes until `release`."""
        self.is_urgent.clear()
        with self._lock:
            messages = [*self._others.waiting, *self._pictures.waiting]
            for lane in (self._pictures, self._others):
                lane.waiting.clear()
                lane.taken_bytes = lane.bytes
        return messages

    def release(self) -> None:
        """What was taken is in the file, or lost."""
        with self._lock:
            for lane in (self._pictures, self._others):
                lane.bytes -= lane.taken_bytes
                lane.taken_bytes = 0

    def lose(self, key: str, count: int = 1) -> None:
        """Count messages of a key that were lost after they had been taken."""
        with self._lock:
            self._lost[key] += count

    @property
    def depth(self) -> int:
        """How many messages wait."""
        return len(self._pictures.waiting) + len(self._others.waiting)

    @property
    def lost(self) -> dict[str, int]:
        """How many messages of each key were lost."""
        with self._lock:
            return dict(self._lost)
