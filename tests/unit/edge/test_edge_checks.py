"""What doctor says of cameras."""

import importlib.util

import pytest

from trigpoint.edge.checks import checks


def test_installed_opencv_is_named_and_every_fault_has_a_remedy() -> None:
    found = checks()
    assert found[0].level == "ok"
    assert found[0].message.startswith("OpenCV 5")
    assert len(found) > 1
    for check in found:
        assert (check.level == "ok") == (check.remedy == "")


def test_missing_opencv_is_an_error_that_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    (check,) = checks()
    assert check.level == "error"
    assert "trigpoint[edge]" in check.remedy
