"""The last hour of what was shown: a whole state each minute, and the changes of each second."""

import threading
import zlib
from collections import deque

import msgspec
from msgspec import Struct, field

from .entities import Change, Entities, Whole, apply

HOUR_S = 3600.0
MINUTE_S = 60.0
_SECOND_S = 1.0
_NEAR_M = 0.05

_STATE = msgspec.json.Decoder(Entities)
_CHANGE = msgspec.json.Decoder(Change)


class _Minute(Struct, frozen=True):
    t: float
    state: bytes
    changes: list[tuple[float, bytes]] = field(default_factory=list)


class History:
    """Bounded by time: an hour and a minute. `keep` is called on one thread, the rest on any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._minutes: deque[_Minute] = deque()
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
        packed = zlib.compress(msgspec.json.encode(self._gathered), 1)
        self._gathered, self._kept_s = Change(t), t
        with self._lock:
            if not self._minutes or t - self._minutes[-1].t >= MINUTE_S:
                self._minutes.append(_Minute(t, zlib.compress(msgspec.json.encode(shown), 1)))
            else:
                self._minutes[-1].changes.append((t, packed))
            while t - self._minutes[0].t > HOUR_S + MINUTE_S:
                self._minutes.popleft()

    @property
    def begin_s(self) -> float | None:
        with self._lock:
            return self._minutes[0].t if self._minutes else None

    def at(self, t: float) -> Whole | None:
        """The state at a time, the earliest one where that is before it; None without any."""
        with self._lock:
            minutes = [m for m in self._minutes if m.t > t - 2 * MINUTE_S] or list(self._minutes)
        if not minutes:
            return None
        state, ways, at_s = _replayed(minutes, t)
        return Whole(at_s, state, ways, past=True)

    def ways(self, t: float) -> dict[str, list[float]]:
        """The ways of the robots in the minute before a time."""
        whole = self.at(t)
        return whole.ways if whole else {}

    @property
    def size(self) -> int:
        """Bytes that are kept."""
        with self._lock:
            minutes = list(self._minutes)
        return sum(len(m.state) + sum(len(packed) for _, packed in m.changes) for m in minutes)


def _replayed(minutes: list[_Minute], t: float) -> tuple[Entities, dict[str, list[float]], float]:
    state: Entities = {}
    ways: dict[str, list[float]] = {}
    at_s = minutes[0].t
    for minute in minutes:
        if state and minute.t > t:
            break
        state, at_s = _STATE.decode(zlib.decompress(minute.state)), minute.t
        _walk(ways, state, at_s > t - MINUTE_S)
        for change_s, packed in list(minute.changes):
            if change_s > t:
                break
            change = _CHANGE.decode(zlib.decompress(packed))
            apply(state, change)
            _walk(ways, change.set, change_s > t - MINUTE_S)
            at_s = change_s
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
