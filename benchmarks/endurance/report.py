"""What a soak run comes to: memory, files and threads, latencies, losses, and what came back."""

from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.table import Row

if TYPE_CHECKING:
    from .soak import Record, Sample

_SETTLED_S = 600.0
"""Memory is held against what it was after ten minutes of a life, or a third of a shorter one."""
_MEASURES = (
    ("memory", "MB", "resident_mb"),
    ("files", "files", "files"),
    ("threads", "threads", "threads"),
)
_row = partial(Row, "soak")


def rows_of(record: "Record") -> Iterator[Row]:
    """All of it."""
    maps = set(record.heard[-1]["maps"]) if record.heard else set()
    yield _row("maps of fusion from begin to end", "maps", len(maps), 1.0, "one is right")
    yield from _programs(record)
    yield from _mended(record)
    yield from _latencies(record)
    yield from _losses(record)


def _programs(record: "Record") -> Iterator[Row]:
    """Of each program's longest life."""
    lives: dict[str, dict[int, list[Sample]]] = defaultdict(lambda: defaultdict(list))
    for sample in record.samples:
        lives[sample.program][sample.process].append(sample)
    for program, each in lives.items():
        life = max(each.values(), key=lambda samples: samples[-1].t_s - samples[0].t_s)
        begin_s, end_s = life[0].t_s, life[-1].t_s
        settled_s, span_s = min(_SETTLED_S, (end_s - begin_s) / 3), (end_s - begin_s) / 10
        from_s = begin_s + settled_s
        early = [one for one in life if from_s <= one.t_s <= from_s + span_s]
        late = [one for one in life if one.t_s >= end_s - span_s]
        what, against = f"{program}, {(end_s - begin_s) / 60:.0f} minutes", "settled"
        for name, unit, field in _MEASURES:
            settled, last = (np.median([getattr(s, field) for s in part]) for part in (early, late))
            yield _row(f"{what}: {name} at the end", unit, float(last), float(settled), against)


def _mended(record: "Record") -> Iterator[Row]:
    back_s: dict[tuple[str, str], list[float]] = defaultdict(list)
    for one in record.breaks:
        back_s[one.kind, one.key].append(one.back_s)
    for (kind, key), found in back_s.items():
        # One that never came back is not a number, and makes the longest none either.
        longest, half = float(np.max(found)), float(np.nanmedian(found))
        against = f"the median of {len(found)}"
        yield _row(f"{kind}, mended: {key} back, longest", "s", longest, half, against)


def _latencies(record: "Record") -> Iterator[Row]:
    heard: dict[str, list[float]] = defaultdict(list)
    for row in record.heard:
        for name, one in row["heard"].items():
            heard[name] += one["latencies"]
    for name, seconds in heard.items():
        half_s, most_s = np.percentile(seconds, [50, 99]) if seconds else [np.nan] * 2
        what = f"{name}, stamp to heard, 99 % of {len(seconds)}"
        yield _row(what, "ms", 1e3 * float(most_s), 1e3 * float(half_s), "50 %")


def _losses(record: "Record") -> Iterator[Row]:
    """By each node's life."""
    for node, lost in sorted(record.heard[-1]["losses"].items()) if record.heard else ():
        for name, count in lost.items():
            if name != "level":
                what = f"{node}: {name.removesuffix('.lost')}, counted as lost"
                yield _row(what, "messages", count, 0.0, "none")
