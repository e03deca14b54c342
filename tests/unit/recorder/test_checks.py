"""What `doctor` hears of the recorder."""

import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from trigpoint.recorder import checks

Usage = namedtuple("Usage", "total used free")


@pytest.mark.parametrize(("free", "level"), [(50e9, "ok"), (5e8, "warning"), (5e7, "error")])
def test_room_to_record_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: float, level: str
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, free))
    check = checks.room(tmp_path / "not" / "there" / "yet")
    assert check.level == level
    assert bool(check.remedy) == (level != "ok")


@pytest.mark.parametrize(("display", "level"), [(":0", "ok"), ("", "warning")])
def test_a_display_is_looked_for(monkeypatch: pytest.MonkeyPatch, display: str, level: str) -> None:
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    found = {check.name: check.level for check in checks.checks()}
    assert found["rerun's viewer"] == level
    assert "room to record" in found


def test_a_missing_package_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks.importlib.util, "find_spec", lambda _: None)
    (check,) = checks.checks()
    assert check.level == "error"
    assert "trigpoint[recorder]" in check.remedy
