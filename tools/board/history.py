"""The last hour of what was shown: a whole state each minute, and the changes of each second.

Packed by the minute, an hour of 100 cameras and 30 robots takes 3 MB; by the second it took 8.
"""

import bz2
import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from itertools import chain

import msgspec
from msgspec import Raw, Struct, field

from .entities import Change, Entities, Whole, apply

HOUR_S = 3600.0
MINUTE_S = 60.0
_SECOND_S = 1.0
_NEAR_M = 0.05


class _Minute(Struct, array_like=True):
    """A state, and what changed from then on: `Entities` and `Change`s, encoded."""

    t: float
    state: Raw
    changes: list[Raw] = field(default_factory=list)


_MINUTE = msgspec.json.Decoder(_Minute)
_STATE = msgspec.json.Decoder(Entities)
_CHANGE = msgspec.json.Decoder(Change)


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
        change, minute = Raw(msgspec.json.encode(self._gathered)), self._minute
        self._gathered, self._kept_s = Change(t), t
        if minute is not None and t - minute.t < MINUTE_S:
            with self._lock:
                minute.changes.append(change)
            return
        packed = None if minute is None else (minute.t, bz2.compress(msgspec.json.encode(minute)))
        with self._lock:
            self._minute = _Minute(t, Raw(msgspec.json.encode(shown)))
            if packed is not None:
                self._packed.append(packed)
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
            packed, last = list(self._packed), self._minute
            if last is None:
                return None
            last = _Minute(last.t, last.state, list(last.changes))
        number = max(0, bisect_right([*(begin_s for begin_s, _ in packed), last.t], t) - 1)
        chosen = packed[max(0, number - 1) : number + 1]  # ways begin in the minute before
        minutes = (_MINUTE.decode(bz2.decompress(data)) for _, data in chosen)
        open_one = [last] if number == len(packed) else []
        with self._replaying:  # a minute takes some MB, and all pages come back at once
            state, ways, at_s = _replayed(chain(minutes, open_one), t)
        return Whole(at_s, state, ways, past=True)

    def ways(self, t: float) -> dict[str, list[float]]:
        """The ways of the robots in the minute before a time."""
        whole = self.at(t)
        return whole.ways if whole else {}

    @property
    def size(self) -> int:
        """Bytes that are kept."""
        with self._lock:
            packed, last = list(self._packed), msgspec.json.encode(self._minute)
        return sum(len(data) for _, data in packed) + len(last)


def _replayed(
    minutes: Iterable[_Minute], t: float
) -> tuple[Entities, dict[str, list[float]], float]:
    state: Entities = {}
    ways: dict[str, list[float]] = {}
    at_s = t
    for minute in minutes:
        if state and minute.t > t:
            break
        state, at_s = _STATE.decode(minute.state), minute.t
        _walk(ways, state, at_s > t - MINUTE_S)
        for raw in minute.changes:
            change = _CHANGE.decode(raw)
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
