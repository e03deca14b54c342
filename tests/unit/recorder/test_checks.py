"""What `doctor` hears of the recorder."""

import pytest

from trigpoint.recorder import checks


@pytest.mark.parametrize(("display", "level"), [(":0", "ok"), ("", "warning")])
def test_a_display_is_looked_for(monkeypatch: pytest.MonkeyPatch, display: str, level: str) -> None:
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    found = {check.name: check.level for check in checks.checks()}
    assert found["rerun's viewer"] == level
