"""`info --at`: in which file of many a moment is."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from support.builders import make_odometry

from trigpoint.base.clock import to_ns
from trigpoint.cli import run
from trigpoint.contract import cdr
from trigpoint.contract.topics import ODOMETRY
from trigpoint.recorder.mcap.writer import McapWriter, Message

DAY = datetime(2026, 11, 20, tzinfo=UTC)


@pytest.fixture
def days(tmp_path: Path) -> Path:
    """Three days from 06:00 to 20:00 UTC: two parts of one recording, and one of its own."""
    names = ("lab_1/session.mcap", "lab_1/session_part2.mcap", "lab_2/session.mcap")
    for number, name in enumerate(names):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        writer = McapWriter(tmp_path / name)
        for hours in (6, 20):
            at_ns = to_ns((DAY + timedelta(days=number, hours=hours)).timestamp())
            payload = cdr.encode(make_odometry(1))
            writer.extend(
                [Message(at_ns, at_ns, ODOMETRY, ODOMETRY.key("lab", "r1"), payload, b"")]
            )
            writer.flush()
        writer.finish()
    (tmp_path / "lab_2" / "broken.mcap").write_bytes(b"no recording")
    return tmp_path


def told(folder: Path, at: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """The status, and what was printed, in one line."""
    status = run(["info", str(folder), "--at", at])
    return status, " ".join("".join(capsys.readouterr()).split())


def test_the_file_is_named_with_its_times(days: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, said = told(days, "2026-11-21T07:00:00Z", capsys)
    assert status == 0
    assert said.startswith(str(days / "lab_1" / "session_part2.mcap"))
    assert said.endswith("3600 s after its start")
    assert said.count(".mcap") == 1


def test_a_moment_without_a_recording_is_said_with_its_neighbours(
    days: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, said = told(days, "2026-11-21T22:00:00Z", capsys)
    assert status == 1
    assert "no recording has" in said
    assert said.index("session_part2.mcap") < said.index(str(days / "lab_2" / "session.mcap"))


@pytest.mark.parametrize(
    ("at", "words"), [("noon", "is no time"), ("2026-11-21", "no recording in")]
)
def test_what_is_wrong_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], at: str, words: str
) -> None:
    status, said = told(tmp_path, at, capsys)
    assert status == 2
    assert words in said
