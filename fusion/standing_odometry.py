"""Chooses the odometry messages that the checkpoint keeps: ever fewer of a robot that stands.

A robot that stands for days repeats the same message fifty times a second. The first messages of a
standstill are kept as they come. Then one is kept whenever the time since the last is twice the
interval before it, so that nothing looks like a gap when it is read again. The last two before the
robot moves on, or falls silent, are kept too, so that a real gap looks like one; of readings with
noise, those by which motion is told from it.
"""

from collections import deque

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose

from .model.odometry import LONGEST_GAP_S, MOST_STANDING
from .model.rest import RECENT_S, Rest

_GROWTH = 2
_FIRST_NS = to_ns(LONGEST_GAP_S / 2)


class StandingOdometry:
    """One robot's odometry on its way to the checkpoint. Not thread-safe."""

    def __init__(self, *, planar: bool = True) -> None:
        self._rest = Rest(planar=planar)
        self._pose: Pose | None = None
        self._last_ns: int | None = None
        # The last messages where they are not stored.
        self._held = deque[tuple[int, bytes]]()
        self._standing = 0
        self._stored_ns, self._step_ns = 0, 0
        self._wanted_ns: int | None = None

    def want(self, stamp_ns: int) -> None:
        """Keep the odometry of this moment too: a sighting of then is stored."""
        self._wanted_ns = stamp_ns

    def take(self, message: Odometry, payload: bytes) -> list[bytes]:
        """Take a message that is newer than those before; the payloads to store now, in order."""
        is_after_gap = self._is_after_gap(message)
        self._standing = self._standing + 1 if self._has_stood(message) else 0
        self._last_ns = message.stamp_ns
        if is_after_gap or self._standing <= MOST_STANDING:
            found = [*self.rest(), payload]
            self._stored(message.stamp_ns)
            return found
        found = []
        if self._is_due():
            stamp_ns, before = self._held.pop()
            self._held.clear()
            self._stored(stamp_ns)
            found.append(before)
        self._held.append((message.stamp_ns, payload))
        reach_ns = to_ns(RECENT_S) if self._rest.trembles else 0
        while len(self._held) > 2 and message.stamp_ns - self._held[0][0] > reach_ns:
            self._held.popleft()
        return found

    def rest(self) -> list[bytes]:
        """The payloads to store before anything that follows."""
        found = [payload for _, payload in self._held]
        if self._held:
            self._stored(self._held[-1][0])
        self._held.clear()
        return found

    def _has_stood(self, message: Odometry) -> bool:
        before = self._pose
        self._pose = here = self._rest.add(message.stamp_ns, message.pose)
        if before is None or not np.array_equal(here.translation, before.translation):
            return False
        return np.array_equal(here.rotation, before.rotation)

    def _is_after_gap(self, message: Odometry) -> bool:
        last_ns = self._last_ns
        return last_ns is not None and message.stamp_ns - last_ns > to_ns(LONGEST_GAP_S)

    def _is_due(self) -> bool:
        """Whether the last message that is held back is to be stored."""
        if not self._held:
            return False
        stamp_ns, _ = self._held[-1]
        if self._wanted_ns is not None and stamp_ns >= self._wanted_ns:
            self._wanted_ns = None
            return True
        return stamp_ns - self._stored_ns >= max(_FIRST_NS, _GROWTH * self._step_ns)

    def _stored(self, stamp_ns: int) -> None:
        self._step_ns, self._stored_ns = stamp_ns - self._stored_ns, stamp_ns
