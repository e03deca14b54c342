"""Rows for rerun, gathered and sent as columns: twenty times cheaper than a call a row."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np
import rerun as rr
from msgspec import Struct, field

from trigpoint.base.clock import NANOSECONDS, to_ns

TIMELINE = "time"
FLUSH_BYTES = 8 * 2**20
_RATE_PERIOD_NS = to_ns(2.0)


def open_stream(site: str, start_ns: int) -> rr.RecordingStream:
    """A rerun recording without a place to go yet; rerun's own errors are raised, not printed."""
    rr.set_strict_mode(True)
    stream = rr.RecordingStream("trigpoint")
    stream.send_recording_name(f"site {site}")
    stream.send_recording_start_time_nanos(start_ns)
    return stream


class _Archetype(Protocol):
    @classmethod
    def columns(cls, **components: Any) -> Iterable[rr.ComponentColumn]: ...


class _Column(Struct):
    """One component: its instances of all rows, and how many each row has."""

    instances: list[Any] = field(default_factory=list)
    lengths: list[int] = field(default_factory=list)


class _Table(Struct):
    """The rows of one entity and archetype; every row has the same components."""

    archetype: type[_Archetype]
    times_ns: list[int] = field(default_factory=list)
    columns: dict[str, _Column] = field(default_factory=dict)


class Columns:
    """Gathers rows and sends them to a recording; used by one thread."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        *,
        keeps: Callable[[type], bool] = lambda _archetype: True,
    ) -> None:
        """`keeps`: which archetypes' rows are sent; the others are passed over."""
        self._stream, self._keeps = stream, keeps
        self._tables: dict[tuple[str, type, frozenset[str]], _Table] = {}
        self._bytes = 0

    def row(
        self, entity: str, time_ns: int, archetype: type[Any], /, **components: Sequence[Any]
    ) -> None:
        """Add one row; each component is given as the list of its instances."""
        if not self._keeps(archetype):
            return
        key = (entity, archetype, frozenset(components))
        table = self._tables.get(key)
        if table is None:
            columns = {name: _Column() for name in components}
            table = self._tables[key] = _Table(archetype, columns=columns)
        table.times_ns.append(time_ns)
        for name, instances in components.items():
            column = table.columns[name]
            column.instances.extend(instances)
            column.lengths.append(len(instances))
            self._bytes += 64 * len(instances)

    def picture(self, entity: str, time_ns: int, data: bytes) -> None:
        """Add one JPEG picture."""
        if not self._keeps(rr.EncodedImage):
            return
        self.row(entity, time_ns, rr.EncodedImage, blob=[data], media_type=["image/jpeg"])
        self._bytes += len(data)

    def fixed(self, entity: str, archetype: rr.AsComponents) -> None:
        """Send what holds at every time."""
        self._stream.log(entity, archetype, static=True)

    @property
    def is_full(self) -> bool:
        """Whether it is time to flush, so that memory stays bounded."""
        return self._bytes > FLUSH_BYTES

    def flush(self) -> None:
        """Send all rows."""
        for (entity, _, _), table in self._tables.items():
            times = np.array(table.times_ns, dtype="datetime64[ns]")
            self._stream.send_columns(
                entity, [rr.TimeColumn(TIMELINE, timestamp=times)], list(_sent(table))
            )
        self._tables.clear()
        self._bytes = 0


class Rate:
    """How often something comes, as a plot: messages a second over two seconds and more."""

    def __init__(self, columns: Columns, entity: str) -> None:
        self._columns, self._entity = columns, entity
        self._since_ns = self._count = 0

    def add(self, stamp_ns: int) -> None:
        """Count one."""
        if not self._since_ns or stamp_ns < self._since_ns:
            self._since_ns, self._count = stamp_ns, 0
            return
        self._count += 1
        after_ns = stamp_ns - self._since_ns
        if after_ns >= _RATE_PERIOD_NS:
            rate = self._count / (after_ns / NANOSECONDS)
            self._columns.row(self._entity, stamp_ns, rr.Scalars, scalars=[rate])
            self._since_ns, self._count = stamp_ns, 0


def _sent(table: _Table) -> Iterable[rr.ComponentColumn]:
    for name, column in table.columns.items():
        for sent in table.archetype.columns(**{name: column.instances}):
            yield sent.partition(column.lengths)
