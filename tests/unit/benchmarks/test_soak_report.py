"""What is said of a soak run: what was broken, and what memory did after it settled."""

import pytest

from benchmarks.endurance.soak import Break, Record, Sample, rows_of


def test_memory_is_held_against_what_it_was_once_settled() -> None:
    samples = [
        Sample(float(t_s), "fusion", 1, 50.0 if t_s < 100 else 100.0 + t_s / 100, 20, 5)
        for t_s in range(0, 1000, 5)
    ]
    memory = next(row for row in rows_of(Record(1000.0, samples)) if "memory" in row.what)
    assert memory.other == pytest.approx(100.0 + 3.83, abs=0.2)
    assert memory.ours == pytest.approx(100.0 + 9.47, abs=0.2)


def test_rows_name_what_broke_and_who_lost() -> None:
    heard = [
        {
            "t": 50.0,
            "heard": {"odom": {"count": 5, "last": 50.0, "latencies": [0.01, 0.02]}},
            "losses": {"edge/c1 7": {"pictures.lost": 3, "level": 1}},
            "maps": ["one", "one"],
        }
    ]
    rows = rows_of(Record(100.0, [], [Break(10.0, "router killed", "odom", 2.5)], heard))
    found = {row.what: (row.ours, row.other, row.unit) for row in rows}
    assert found["maps of fusion from begin to end"] == (1, 1, "maps")
    assert found["router killed, mended: odom back, longest"] == (2.5, 2.5, "s")
    assert found["edge/c1 7: pictures, counted as lost"] == (3, 0, "messages")
    assert found["odom, stamp to heard, 99 % of 2"] == (
        pytest.approx(19.9),
        pytest.approx(15.0),
        "ms",
    )
