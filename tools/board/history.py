"""The last hour of what was shown: a whole state each minute, and the changes of each second.

Every second is packed as it comes, in a millisecond or two of a large site: a whole minute packed
at once would hold up what is shown by 60 to 220 ms.
"""

import threading
import zlib
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from itertools import starmap
from operator import itemgetter

import msgspec

from .entities import Change, Entities, Whole, apply

HOUR_S = 3600.0
MINUTE_S = 60.0
_SECOND_S = 1.0
_NEAR_M = 0.05

_STATE = msgspec.json.Decoder(Entities)
_CHANGE = msgspec.json.Decoder(Change)


class _Minute:
    """A state, and what changed from then on: a line of JSON each, packed."""

    def __init__(self, t: float, state: Entities) -> None:
        self.t = t
        self._packer, self._packed = zlib.compressobj(), bytearray()
        self.add(state)

    def add(self, line: Entities | Change) -> None:
        self._packed += self._packer.compress(msgspec.json.encode(line) + b"\n")

    def whole(self) -> bytes:
        """All up to now, as `_unpacked` reads it."""
        return bytes(self._packed) + self._packer.copy().flush()


def _unpacked(t: float, packed: bytes) -> tuple[float, Entities, Iterable[Change]]:
    state, *changes = zlib.decompress(packed).splitlines()
    return t, _STATE.decode(state), map(_CHANGE.decode, changes)


class History:
    """Bounded by time: an hour and a minute. `keep` is called on one thread, the rest on any."""

    def __init__(self) -> None:
        self._lock, self._replaying = threading.Lock(), threading.Lock()
        self._packed: deque[tuple[float, bytes]] = deque()
        self._minute: _Minute | None = None
        self._gathered = Change(0.0)
        self._kept_s = 0.0

    def keep(self, change: Change, shown: Entities, t: float) -> None:
        """Take one change, after which `shown` is the state."""
        gathered = {**self._gathered.set}
        apply(gathered, Change(t, change.set))
        gone = tuple(dict.fromkeys((*self._gathered.gone, *change.gone)))
        self._gathered = Change(t, gathered, tuple(name for name in gone if name not in shown))
        if t - self._kept_s >= _SECOND_S:
            self._keep_second(shown, t)

    def _keep_second(self, shown: Entities, t: float) -> None:
        change, minute = self._gathered, self._minute
        self._gathered, self._kept_s = Change(t), t
        with self._lock:
            if minute is not None and t - minute.t < MINUTE_S:
                minute.add(change)
                return
            if minute is not None:
                self._packed.append((minute.t, minute.whole()))
            self._minute = _Minute(t, shown)
            while self._packed and t - self._packed[0][0] > HOUR_S + MINUTE_S:
                self._packed.popleft()

    @property
    def begin_s(self) -> float | None:
        with self._lock:
            if self._packed:
                return self._packed[0][0]
            return self._minute.t if self._minute is not None else None

    def at(self, t: float) -> Whole | None:
        """The state at a time, the earliest one where that is before it; None without any."""
        with self._lock:
            if self._minute is None:
                return None
            packed = [*self._packed, (self._minute.t, self._minute.whole())]
        number = max(0, bisect_right(packed, t, key=itemgetter(0)) - 1)
        chosen = packed[max(0, number - 1) : number + 1]  # ways begin in the minute before
        with self._replaying:  # a minute takes some MB, and all pages come back at once
            state, ways, at_s = _replayed(starmap(_unpacked, chosen), t)
        return Whole(at_s, state, ways, past=True)

    def ways(self, t: float) -> dict[str, list[float]]:
        """The ways of the robots in the minute before a time."""
        whole = self.at(t)
        return whole.ways if whole else {}

    @property
    def size(self) -> int:
        """Bytes that are kept."""
        with self._lock:
            last = b"" if self._minute is None else self._minute.whole()
            return sum(len(data) for _, data in self._packed) + len(last)


def _replayed(
    minutes: Iterable[tuple[float, Entities, Iterable[Change]]], t: float
) -> tuple[Entities, dict[str, list[float]], float]:
    state: Entities = {}
    ways: dict[str, list[float]] = {}
    at_s = t
    for begin_s, begin, changes in minutes:
        if state and begin_s > t:
            break
        state, at_s = begin, begin_s
        _walk(ways, state, at_s > t - MINUTE_S)
        for change in changes:
            if change.t > t:
                break
            apply(state, change)
            _walk(ways, change.set, change.t > t - MINUTE_S)
            at_s = change.t
    return state, ways, at_s


def _walk(ways: dict[str, list[float]], entities: Entities, is_recent: bool) -> None:
    """Append where robots are, if that is not where they were already."""
    for name, fields in entities.items():
        at = fields.get("at")
        if not is_recent or not name.startswith("robot/") or not isinstance(at, list):
            continue
        way = ways.setdefault(name, [])
        if not way or abs(way[-2] - at[0]) + abs(way[-1] - at[1]) > _NEAR_M:
            way += at[:2]
