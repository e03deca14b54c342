"""The commands `target check` and `target draw`, as a user runs them."""

import base64
import json
import re
import zlib
from pathlib import Path

import pytest

from trigpoint.cli import run
from trigpoint.tools.simulation.targets import target_of, target_text
from trigpoint.tools.target_drawing import sheet_for


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "target.toml"
    path.write_text(target_text(target_of("checkerboard")))
    return path


def pages(pdf: Path) -> list[str]:
    """The drawing commands of each page."""
    found = re.findall(rb"stream\r?\n(.*?)endstream", pdf.read_bytes(), re.DOTALL)
    return [zlib.decompress(base64.a85decode(data.strip()[:-2])).decode() for data in found]


def test_sound_target_is_said_to_be_so(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["target", "check", str(file)]) == 0
    out = capsys.readouterr().out
    assert "target «three-plane» is sound: 6 faces, 288 corners" in out
    assert "look alike" in out


def test_check_as_json(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["target", "check", "--json", str(file)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["target"], result["problems"], len(result["notes"])) == ("three-plane", [], 2)


def test_unsound_target_exits_2_with_one_line(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = target_text(target_of("charuco")).replace("first_marker = 50", "first_marker = 245")
    file.write_text(text)
    assert run(["target", "check", str(file)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert f"{file}: 1 to mend: face 5 needs markers 245 to 254, but DICT_4X4_250 has 250" in line
    assert run(["target", "draw", str(file)]) == 2


def test_missing_target_exits_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["target", "check", str(tmp_path / "none.toml")]) == 2
    assert "there is no such target file" in capsys.readouterr().err


def test_drawing_has_a_page_a_face_at_true_scale(file: Path) -> None:
    assert run(["target", "draw", str(file)]) == 0
    drawn = pages(file.with_suffix(".pdf"))
    assert len(drawn) == 6
    for page in drawn:
        [_, *scale] = re.findall(r"([\d.]+) 0 0 ([\d.]+) 0 0 cm", page)
        assert scale == [("2.834646", "2.834646")]  # points a millimetre: 72 / 25.4
        squares = re.findall(r"([\d.-]+) ([\d.-]+) ([\d.-]+) ([\d.-]+) re", page)
        assert len(squares) == 32  # of 9 × 7
        assert {(width, height) for _, _, width, height in squares} == {("28.5", "-28.5")}
        bar = re.search(r"([\d.]+) 6 m ([\d.]+) 6 l", page)
        assert bar is not None
        assert float(bar[2]) - float(bar[1]) == 100.0


def test_page_is_the_smallest_that_holds_the_face() -> None:
    charuco, checkerboard = target_of("charuco").faces[0], target_of("checkerboard").faces[0]
    assert sheet_for(charuco).name == "A3 lying"
    assert sheet_for(checkerboard).name == "A3 upright"


def test_same_target_is_drawn_as_the_same_bytes(file: Path, tmp_path: Path) -> None:
    for name in ("a.pdf", "b.pdf"):
        assert run(["target", "draw", str(file), "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_folder_that_does_not_exist_is_one_clear_line(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["target", "draw", str(file), "--out", str(tmp_path / "no" / "x.pdf")]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert "cannot be written" in line
