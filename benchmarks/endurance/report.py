"""What a soak run comes to: memory, files and threads, latencies, losses, and what came back."""

from collections import defaultdict
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.table import columns

if TYPE_CHECKING:
    from .soak import Record, Sample

_SETTLED_S = 600.0
"""Memory is held against what it was after ten minutes of a life, or a third of a shorter one."""


def report(record: "Record") -> str:
    """The tables, as Markdown."""
    maps = record.heard[-1]["maps"] if record.heard else []
    tables = (_programs(record), _mended(record), _latencies(record), _losses(record))
    return "\n\n".join(
        [
            f"# Soak run of {record.seconds / 60:.0f} minutes, {len(record.breaks)} breaks",
            f"Maps of fusion from begin to end, in order (one is right): {', '.join(maps)}",
            *("\n".join(columns(list(table))) for table in tables),
        ]
    )


def _programs(record: "Record") -> Iterator[tuple[str, ...]]:
    """Of each program's longest life."""
    yield "program", "life, minutes", "settled, MB", "at the end, MB", "ratio", "files", "threads"
    lives: dict[str, dict[int, list[Sample]]] = defaultdict(lambda: defaultdict(list))
    for sample in record.samples:
        lives[sample.program][sample.process].append(sample)
    for name, each in lives.items():
        life = max(each.values(), key=lambda samples: samples[-1].t_s - samples[0].t_s)
        settled, last = memory_ratio_parts([(s.t_s, s.resident_mb) for s in life])
        yield (
            name,
            f"{(life[-1].t_s - life[0].t_s) / 60:.0f}",
            f"{settled:.1f}",
            f"{last:.1f}",
            f"{last / settled:.3f}",
            f"{life[len(life) // 3].files} to {life[-1].files}",
            f"{life[len(life) // 3].threads} to {life[-1].threads}",
        )


def memory_ratio_parts(points: list[tuple[float, float]]) -> tuple[float, float]:
    """(settled, at the end) of one life, each the median of a tenth of it."""
    begin_s, end_s = points[0][0], points[-1][0]
    settled_s, span_s = min(_SETTLED_S, (end_s - begin_s) / 3), (end_s - begin_s) / 10
    from_s = begin_s + settled_s
    early = [value for t_s, value in points if from_s <= t_s <= from_s + span_s]
    late = [value for t_s, value in points if t_s >= end_s - span_s]
    return float(np.median(early)), float(np.median(late))


def _mended(record: "Record") -> Iterator[tuple[str, ...]]:
    yield "what was mended", "seen by", "times", "back after, median", "longest"
    back_s: dict[tuple[str, str], list[float]] = defaultdict(list)
    for one in record.breaks:
        back_s[one.kind, one.key].append(one.back_s)
    for (kind, key), found in back_s.items():
        # One that never came back is not a number, and makes the longest none either.
        yield kind, key, str(len(found)), f"{np.nanmedian(found):.1f} s", f"{np.max(found):.1f} s"


def _latencies(record: "Record") -> Iterator[tuple[str, ...]]:
    yield "messages", "heard", "latency from the stamp, 50 %", "95 %", "99 %"
    heard: dict[str, list[float]] = defaultdict(list)
    for row in record.heard:
        for name, one in row["heard"].items():
            heard[name] += one["latencies"]
    for name, seconds in heard.items():
        marks = np.percentile(seconds, [50, 95, 99]) if seconds else [np.nan] * 3
        yield name, str(len(seconds)), *(f"{1e3 * mark:.0f} ms" for mark in marks)


def _losses(record: "Record") -> Iterator[tuple[str, ...]]:
    """By each node's life."""
    yield "node, process", "counted as lost", "how many"
    for node, lost in sorted(record.heard[-1]["losses"].items()) if record.heard else ():
        for name, count in lost.items():
            if name != "level":
                yield node, name.removesuffix(".lost"), str(count)
