"""The commands `target check` and `target draw`, as a user runs them."""

import base64
import json
import re
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import pytest
from support.commands import Cli

from trigpoint.cli import run
from trigpoint.site.target import load_target
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.target.sheets import sheet_for


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "target.toml"
    path.write_text(target_text(target_of("checkerboard")))
    return path


def pages(pdf: Path) -> list[str]:
    """The drawing commands of each page."""
    found = re.findall(rb"stream\r?\n(.*?)endstream", pdf.read_bytes(), re.DOTALL)
    return [zlib.decompress(base64.a85decode(data.strip()[:-2])).decode() for data in found]


def test_sound_target_is_said_to_be_so(file: Path, cli: Cli) -> None:
    out = cli("target", "check", file).out
    assert "target «three-plane» is sound: 6 faces, 288 corners" in out
    assert "look alike" in out


def test_check_needs_no_printer(file: Path) -> None:
    """A camera's machine has no `reportlab`; there a target is checked all the same."""
    code = (
        "import sys; sys.modules['reportlab'] = None; from trigpoint.cli import run; "
        "sys.exit(run(['target', 'check', sys.argv[1]]))"
    )
    words = [sys.executable, "-c", code, str(file)]
    assert subprocess.run(words, capture_output=True, timeout=60).returncode == 0


def test_check_as_json(file: Path, cli: Cli) -> None:
    result = json.loads(cli("target", "check", "--json", file).out)
    assert (result["target"], result["problems"], len(result["notes"])) == ("three-plane", [], 2)


def test_unsound_target_exits_2_with_one_line(file: Path, cli: Cli) -> None:
    text = target_text(target_of("charuco")).replace("first_marker = 50", "first_marker = 245")
    file.write_text(text)
    [line] = cli("target", "check", file, status=2).err.splitlines()
    assert f"{file}: 1 to mend: face 5 needs markers 245 to 254, but DICT_4X4_250 has 250" in line
    cli("target", "draw", file, status=2)


def test_missing_target_exits_2(tmp_path: Path, cli: Cli) -> None:
    assert "there is no such target file" in cli.refused("target", "check", tmp_path / "none.toml")


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


def test_folder_that_does_not_exist_is_one_clear_line(file: Path, tmp_path: Path, cli: Cli) -> None:
    [line] = cli(
        "target", "draw", file, "--out", tmp_path / "no" / "x.pdf", status=1
    ).err.splitlines()
    assert "cannot be written" in line


CHECKERBOARD = 'pattern = "checkerboard"\ncolumns = 5\nrows = 3\nsquare = 0.03\n'
BOARD = "columns = {0}\nrows = {0}\nsquare = 0.03\nmarker = 0.02\n"


@pytest.mark.parametrize(
    ("face", "drawn"),
    [
        (CHECKERBOARD, "  ##  ##  ##\n    ##  ##  \n  ##  ##  ##\n"),
        (CHECKERBOARD + "inverted = true\n", "    ##  ##  \n  ##  ##  ##\n    ##  ##  \n"),
        # where OpenCV has its markers
        (
            f'pattern = "charuco"\n{BOARD.format(3)}dictionary = "DICT_4X4_50"\nfirst_marker = 7\n',
            "  ## 7##\n   8## 9\n  ##10##\n",
        ),
        # Kalibr's, from the bottom left
        (
            f'pattern = "aprilgrid"\n{BOARD.format(2)}dictionary = "DICT_APRILTAG_36h11"\n'
            'numbering = "kalibr"\n',
            "##    ##    ##\n    [ 2]  [ 3]  \n",
        ),
    ],
)
def test_check_draws_a_board_as_it_is_printed(
    tmp_path: Path, cli: Cli, face: str, drawn: str
) -> None:
    path = tmp_path / "t.toml"
    here = "translation = [0.0, 0.0, 0.0]\nquaternion = [0.0, 0.0, 0.0, 1.0]"
    path.write_text(f'name = "t"\n[[faces]]\nid = 0\n{face}{here}\n')
    assert drawn in cli("target", "check", path).out


def test_check_draws_a_picture_of_each_face(file: Path, tmp_path: Path, cli: Cli) -> None:
    assert "##" not in cli("target", "check", file, "--picture", tmp_path / "board.png").out
    faces = target_of("checkerboard").faces
    for face in faces:
        drawn = cv2.imread(str(tmp_path / f"board_{face.id}.png"))
        assert drawn is not None
        assert drawn.shape[0] > 900 or drawn.shape[1] > 900


APRIL = "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 5\ntagSize: 0.088  # m\ntagSpacing: 0.3\n"
CHECKER = (
    "target_type: checkerboard\ntargetCols: 8\ntargetRows: 6\nrowSpacingMeters: 0.06\n"
    "colSpacingMeters: 0.06\n"
)


def test_kalibrs_aprilgrid_is_imported(tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "april_6x5.yaml").write_text(APRIL + "codeOffset: 4\n")
    cli("target", "import", tmp_path / "april_6x5.yaml")
    [face] = load_target(tmp_path / "target.toml").faces
    assert (face.columns, face.rows, face.marker, face.first_marker) == (6, 5, 0.088, 4)
    assert face.square == pytest.approx(0.1144)
    assert (face.border_bits, face.numbering, face.has_corner_squares) == (2, "kalibr", True)
    assert "is sound" in cli("target", "check", tmp_path / "target.toml").out


def test_kalibrs_checkerboard_is_imported_by_its_squares(tmp_path: Path) -> None:
    (tmp_path / "board.yaml").write_text(CHECKER)
    out = tmp_path / "mine.toml"
    assert run(["target", "import", str(tmp_path / "board.yaml"), "--out", str(out)]) == 0
    [face] = load_target(out).faces
    assert (face.pattern, face.columns, face.rows, face.square) == ("checkerboard", 9, 7, 0.06)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (APRIL.replace("tagSize: 0.088", "tagSize: -1"), "tagSize: expected «float» > 0"),
        (APRIL.replace("tagSize: 0.088", "tagSize: .inf"), "tagSize is inf"),
        (APRIL.replace("tagSpacing: 0.3", "tagSpacing: .inf"), "tagSpacing is inf"),
        (APRIL.replace("tagSpacing: 0.3", "tagSpacing: 0.0264"), "in metres, 0.3 is meant"),
        (
            CHECKER.replace("rowSpacingMeters: 0.06", "rowSpacingMeters: .inf"),
            "rowSpacingMeters is inf",
        ),
        (APRIL.replace("tagRows: 5\n", ""), "needs the key «tagRows»"),
        (APRIL + "tagBits: 2\n", "tagBits is not a known key"),
        (CHECKER.replace("rowSpacingMeters: 0.06", "rowSpacingMeters: 0.05"), "square squares"),
        (CHECKER.replace("targetCols: 8", "targetCols: 6"), "make columns and rows differ"),
        ("target_type: circlegrid\n", "target_type is «circlegrid»"),
        ("target_type: [1]\n", "target_type is «[1]»"),
        ("- 1\n", "a mapping is needed"),
    ],
)
def test_what_cannot_be_imported_is_named(tmp_path: Path, cli: Cli, text: str, why: str) -> None:
    (tmp_path / "board.yaml").write_text(text)
    assert why in cli.refused("target", "import", tmp_path / "board.yaml")
    assert not (tmp_path / "target.toml").exists()


def test_import_replaces_a_file_only_when_told(tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "board.yaml").write_text(APRIL)
    (tmp_path / "target.toml").write_text("mine")
    assert "add --force" in cli.refused("target", "import", tmp_path / "board.yaml")
    assert (tmp_path / "target.toml").read_text() == "mine"
    cli("target", "import", tmp_path / "board.yaml", "--force")
