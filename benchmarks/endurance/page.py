"""One page of a soak run: what programs held over time, latencies, losses, and what came back."""

import html
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .soak import Record

_WIDTH, _HEIGHT, _LEFT, _FOOT = 860, 180, 70, 22
_COLOURS = ("#0b6e99", "#b5482f", "#4c7a34", "#7a4c9e", "#a07d1c", "#555555")
_SETTLED_S = 600.0
"""Memory is held against what it was after ten minutes of a life, or a third of a shorter one."""

Series = dict[str, list[tuple[float, float]]]


def page(record: "Record") -> str:
    """The page as HTML, with its drawings inside."""
    parts = [
        "<!doctype html><meta charset=utf-8><title>Soak run</title>",
        "<style>body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto}"
        "td,th{padding:2px 12px;text-align:left}svg{display:block}</style>",
        f"<h1>Soak run of {record.seconds / 60:.0f} minutes</h1>",
        _maps(record),
        _memory_table(record),
        _drawn("Resident memory, MB", _of_programs(record, "resident", 1e-6), record),
        _drawn("Open files", _of_programs(record, "files", 1.0), record),
        _drawn("Threads", _of_programs(record, "threads", 1.0), record),
        _drawn("Latency from the stamp, 95th percentile of 10 s, ms", _latencies(record), record),
        _losses(record),
        _backs(record),
    ]
    return "\n".join(parts) + "\n"


def _maps(record: "Record") -> str:
    maps = record.heard[-1]["maps"] if record.heard else []
    return f"<p>Maps of fusion from begin to end, in order (one is right): {', '.join(maps)}</p>"


def _backs(record: "Record") -> str:
    rows = [
        f"<tr><td>{b.t_s:.0f} s<td>{html.escape(b.kind)}<td>{b.key}<td>{b.back_s:.1f} s"
        for b in record.breaks
    ]
    return (
        "<h2>What broke</h2><table><tr><th>when<th>what<th>seen by<th>back after mending"
        f"{''.join(rows)}</table>"
    )


def _memory_table(record: "Record") -> str:
    rows = []
    for name, points in _longest_lives(record).items():
        settled, last = memory_ratio_parts(points)
        minutes = (points[-1][0] - points[0][0]) / 60
        rows.append(
            f"<tr><td>{name}<td>{minutes:.0f}<td>{settled:.1f}<td>{last:.1f}"
            f"<td>{last / settled:.3f}"
        )
    return (
        "<h2>Memory</h2><p>Of each program's longest life, after ten minutes of it (or a third of "
        "a shorter one) and at its end.</p><table><tr><th>program<th>life, minutes"
        f"<th>settled, MB<th>at the end, MB<th>ratio{''.join(rows)}</table>"
    )


def _longest_lives(record: "Record") -> Series:
    """Resident megabytes over time of each program, of that process which lived longest."""
    lives: dict[str, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for sample in record.samples:
        lives[sample.program][sample.process].append((sample.t_s, 1e-6 * sample.resident))
    return {name: max(each.values(), key=_length_s) for name, each in lives.items()}


def _length_s(points: list[tuple[float, float]]) -> float:
    return points[-1][0] - points[0][0]


def memory_ratio_parts(points: list[tuple[float, float]]) -> tuple[float, float]:
    """(settled, at the end) of one life, each the median of a tenth of it."""
    begin_s, end_s = points[0][0], points[-1][0]
    settled_s, span_s = min(_SETTLED_S, (end_s - begin_s) / 3), (end_s - begin_s) / 10
    from_s = begin_s + settled_s
    early = [value for t_s, value in points if from_s <= t_s <= from_s + span_s]
    late = [value for t_s, value in points if t_s >= end_s - span_s]
    return float(np.median(early)), float(np.median(late))


def _of_programs(record: "Record", what: str, scale: float) -> Series:
    series: Series = defaultdict(list)
    for sample in record.samples:
        series[sample.program].append((sample.t_s, scale * getattr(sample, what)))
    return dict(series)


def _latencies(record: "Record") -> Series:
    bins: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in record.heard:
        for name, one in row["heard"].items():
            bins[name][int(row["t"] // 10)] += one["latencies"]
    return {
        name: [(10.0 * n + 5, 1e3 * float(np.quantile(v, 0.95))) for n, v in sorted(b.items()) if v]
        for name, b in bins.items()
    }


def _losses(record: "Record") -> str:
    last = record.heard[-1]["losses"] if record.heard else {}
    rows = [
        f"<tr><td>{html.escape(node)}<td>{html.escape(name.removesuffix('.lost'))}<td>{count}"
        for node, lost in sorted(last.items())
        for name, count in lost.items()
        if name != "level"
    ]
    return (
        "<h2>Counted as lost, by each node's life (name, process)</h2>"
        f"<table>{''.join(rows) or '<tr><td>nothing'}</table>"
    )


def _drawn(title: str, series: Series, record: "Record") -> str:
    most = max((value for points in series.values() for _, value in points), default=1.0) or 1.0
    lines = [f'<svg width="{_WIDTH}" height="{_HEIGHT + _FOOT}" font-size="11">']
    for one in record.breaks:
        x = _x(one.t_s, record)
        lines.append(f'<line x1="{x}" x2="{x}" y1="0" y2="{_HEIGHT}" stroke="#ddd"/>')
    for share in (0.0, 0.5, 1.0):
        y = _HEIGHT - share * (_HEIGHT - 12)
        lines.append(f'<line x1="{_LEFT}" x2="{_WIDTH}" y1="{y}" y2="{y}" stroke="#bbb"/>')
        text = f"{share * most:,.0f}"
        lines.append(f'<text x="{_LEFT - 6}" y="{y + 4}" text-anchor="end">{text}</text>')
    for number, (name, points) in enumerate(sorted(series.items())):
        colour = _COLOURS[number % len(_COLOURS)]
        way = " ".join(
            f"{_x(t_s, record):.1f},{_HEIGHT - value / most * (_HEIGHT - 12):.1f}"
            for t_s, value in points
        )
        lines.append(f'<polyline points="{way}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        x = _LEFT + 120 * number
        lines.append(f'<text x="{x}" y="{_HEIGHT + 16}" fill="{colour}">{html.escape(name)}</text>')
    return f"<h2>{title}</h2>" + "".join([*lines, "</svg>"])


def _x(t_s: float, record: "Record") -> float:
    return _LEFT + t_s / record.seconds * (_WIDTH - _LEFT)
