"""The page of a soak run says what was broken, and what memory did after it settled."""

import pytest

from benchmarks.endurance.page import memory_ratio_parts, page
from benchmarks.endurance.soak import Break, Record, Sample


def test_memory_is_held_against_what_it_was_once_settled() -> None:
    points = [(t_s, 50.0 if t_s < 100 else 100.0 + t_s / 100) for t_s in range(0, 1000, 5)]
    settled, last = memory_ratio_parts([(float(t), m) for t, m in points])
    assert settled == pytest.approx(100.0 + 3.83, abs=0.2)
    assert last == pytest.approx(100.0 + 9.47, abs=0.2)


def test_page_names_what_broke_and_who_lost() -> None:
    samples = [Sample(float(t), "fusion", 1, 10_000_000 + t, 20, 5) for t in range(100)]
    heard = [
        {
            "t": 50.0,
            "heard": {"odom": {"count": 5, "last": 50.0, "latencies": [0.01, 0.02]}},
            "losses": {"edge/c1 7": {"pictures.lost": 3, "level": 1}},
            "maps": ["one"],
        }
    ]
    record = Record(100.0, samples, [Break(10.0, "router <killed>", "odom", 2.5)], heard)
    text = page(record)
    assert "router &lt;killed&gt;" in text
    assert "2.5 s" in text
    assert "<td>edge/c1 7<td>pictures<td>3" in text
    assert text.count("<polyline") == 4
