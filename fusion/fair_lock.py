"""A lock that is granted in the order of the requests.

An ordinary lock goes to whichever thread asks first: one that works in turns and is never idle
would keep all others out for as long as it has work.
"""

import threading
from collections import deque
from types import TracebackType


class FairLock:
    """Used by `with`; `acquire` with a time limit. Not reentrant. Any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: deque[threading.Lock] = deque()
        self._is_held = False

    def acquire(self, timeout_s: float = -1.0) -> bool:
        """Whether the lock was granted within the time; -1: wait for ever."""
        with self._lock:
            if not self._is_held:
                self._is_held = True
                return True
            mine = threading.Lock()
            mine.acquire()
            self._waiting.append(mine)
        if mine.acquire(timeout=timeout_s):
            return True
        with self._lock:
            if mine in self._waiting:
                self._waiting.remove(mine)
                return False
        return True  # handed over just as the time was over

    def release(self) -> None:
        """Grant it to the thread that has waited longest."""
        with self._lock:
            if self._waiting:
                self._waiting.popleft().release()
            else:
                self._is_held = False

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()
