"""The benchmarks open, and give rows that can be printed and written."""

import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.fusion.corridor import Corridor
from benchmarks.network import board_beside, messages
from benchmarks.report import machine, write_report
from benchmarks.table import BENCHMARKS, Row, formatted
from trigpoint.contract.messages import Odometry, Sightings


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_name_of_the_table_opens(name: str) -> None:
    if not BENCHMARKS[name].is_installed:
        pytest.skip(f"{BENCHMARKS[name].needs} is not installed")
    assert callable(BENCHMARKS[name].open())


def test_a_benchmark_gives_rows_with_both_sides_and_their_ratio() -> None:
    rows = messages.run(0.01)
    assert [row.what.split()[0] for row in rows] == ["encode", "decode"] * 3
    for row in rows:
        assert row.benchmark == "messages"
        assert row.ours > 0
        assert row.other > 0
        assert row.ratio is not None
        assert math.isclose(row.ratio * row.other, row.ours)


def test_a_row_against_nothing_has_no_ratio_and_is_printed_and_written(tmp_path: Path) -> None:
    row = Row("detection", "wrong faces", "faces", 2, 0, "OpenCV")
    assert row.ratio is None
    assert "| 2 " in formatted([row])[2]
    path = tmp_path / "new" / "rows.json"
    write_report(path, [row], machine(), effort=1.0)
    report = json.loads(path.read_text(encoding="utf-8"))
    assert report["rows"][0]["ratio"] is None
    assert report["machine"]["cores"] >= 1


def test_a_robot_of_a_load_stands_where_it_arrived_and_is_seen_there() -> None:
    corridor = Corridor(10, 87.5, stands_s=2.0)  # once round
    messages = [m for _, m in corridor.messages() if isinstance(m, Odometry | Sightings)]
    last_ns = messages[-1].stamp_ns
    standing = [m for m in messages if m.stamp_ns > last_ns - 1_500_000_000]
    poses = [m.pose.translation for m in standing if isinstance(m, Odometry)]
    assert len(poses) == 30
    assert all((pose == poses[0]).all() for pose in poses)
    assert any(isinstance(m, Sightings) and m.faces for m in standing)
    assert corridor.measured_from_s == 87.5


def test_a_program_beside_that_nobody_reads_has_no_pipe() -> None:
    with board_beside.program("--version") as process:
        assert process.stdout is None


def test_a_program_beside_that_does_not_stop_is_killed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    deaf = tmp_path / "deaf"
    words = "signal.signal(signal.SIGTERM, signal.SIG_IGN); print('ready'); time.sleep(60)"
    deaf.write_text(f"#!{sys.executable} -u\nimport signal, time; {words}\n", encoding="utf-8")
    deaf.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(deaf))
    monkeypatch.setattr(board_beside, "_STOP_S", 0.1)
    context = board_beside.program(stdout=subprocess.PIPE)
    process = context.__enter__()
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    with pytest.raises(subprocess.TimeoutExpired):
        context.__exit__(None, None, None)
    assert process.returncode == -signal.SIGKILL
