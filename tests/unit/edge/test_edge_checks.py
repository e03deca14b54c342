"""What doctor says of cameras."""

from trigpoint.edge.checks import checks


def test_installed_opencv_is_named_and_every_fault_has_a_remedy() -> None:
    found = checks()
    assert found[0].level == "ok"
    assert found[0].message.startswith("OpenCV 5")
    assert len(found) > 1
    for check in found:
        assert (check.level == "ok") == (check.remedy == "")
