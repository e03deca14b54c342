"""The report of a soak run says what was broken, and what memory did after it settled."""

import json
from pathlib import Path

import pytest

from benchmarks.endurance.report import memory_ratio_parts, report
from benchmarks.endurance.soak import Break, Record, Sample, write_record


def test_memory_is_held_against_what_it_was_once_settled() -> None:
    points = [(t_s, 50.0 if t_s < 100 else 100.0 + t_s / 100) for t_s in range(0, 1000, 5)]
    settled, last = memory_ratio_parts([(float(t), m) for t, m in points])
    assert settled == pytest.approx(100.0 + 3.83, abs=0.2)
    assert last == pytest.approx(100.0 + 9.47, abs=0.2)


def test_report_names_what_broke_and_who_lost() -> None:
    samples = [Sample(float(t), "fusion", 1, 10.0 + 1e-6 * t, 20, 5) for t in range(100)]
    heard = [
        {
            "t": 50.0,
            "heard": {"odom": {"count": 5, "last": 50.0, "latencies": [0.01, 0.02]}},
            "losses": {"edge/c1 7": {"pictures.lost": 3, "level": 1}},
            "maps": ["one"],
        }
    ]
    record = Record(100.0, samples, [Break(10.0, "router killed", "odom", 2.5)], heard)
    lines = [" ".join(line.split()) for line in report(record).splitlines()]
    assert "| router killed | odom | 1 | 2.5 s | 2.5 s |" in lines
    assert "| edge/c1 7 | pictures | 3 |" in lines
    assert "| fusion | 2 | 10.0 | 10.0 | 1.000 | 20 to 20 | 5 to 5 |" in lines
    assert "| odom | 2 | 15 ms | 20 ms | 20 ms |" in lines


def test_what_was_seen_is_written_whole(tmp_path: Path) -> None:
    record = Record(9.0, [Sample(1.0, "fusion", 1, 10.0, 20, 5)], [Break(2.0, "cut", "odom", 0.5)])
    write_record(record, tmp_path)
    written = json.loads((tmp_path / "soak.json").read_text())
    assert written["samples"][0]["program"] == "fusion"
    assert written["breaks"][0]["back_s"] == 0.5
    assert (tmp_path / "soak.md").exists()
