"""The command `target make`, as a user runs it: where its faces are, and that cameras see them."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.commands import Cli

from trigpoint.cli import run
from trigpoint.map.network import load_network
from trigpoint.site.target import Face, Pattern, Target, load_target
from trigpoint.tools.shapes.bodies import MARGIN_M
from trigpoint.tools.simulation import world as world_module
from trigpoint.tools.simulation.drawing.rendering import CameraRenderer
from trigpoint.tools.simulation.session import write_session
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.simulation.world import load_world

LENGTH_M, WIDTH_M, TALL_M, HEIGHT_M, AT_M = 0.5, 0.36, 0.4, 0.45, (0.1, -0.05)
NORMALS = {"front": (1, 0), "left": (0, 1), "back": (-1, 0), "right": (0, -1)}
PATTERNS = [pattern.value for pattern in Pattern]


def made(folder: Path, *words: str) -> Target:
    """The target that the command writes."""
    file = folder / "target.toml"
    assert run(["target", "make", *words, "--out", str(file)]) == 0
    return load_target(file)


def normal(face: Face) -> np.ndarray:
    """Out of the board, towards who looks at it, in the base."""
    return -face.base_from_face.rotation[:, 2]


def outline(face: Face) -> np.ndarray:
    return face.base_from_face @ face.outline


@pytest.mark.parametrize("pattern", PATTERNS)
def test_faces_of_a_box_lie_on_its_sides_and_look_outwards(tmp_path: Path, pattern: str) -> None:
    box = f"{LENGTH_M}x{WIDTH_M}x{TALL_M}"
    place = ["--height", str(HEIGHT_M), "--at", f"{AT_M[0]},{AT_M[1]}"]
    target = made(tmp_path, "--box", box, *place, "--pattern", pattern)
    assert len(target.faces) == 4
    for face, (x, y) in zip(target.faces, NORMALS.values(), strict=True):
        assert normal(face) == pytest.approx([x, y, 0], abs=1e-9)
        corners = (face.base_from_face @ face.corners) - [*AT_M, HEIGHT_M]
        out, wide = (LENGTH_M, WIDTH_M) if x else (WIDTH_M, LENGTH_M)
        assert corners @ [x, y, 0] == pytest.approx(out / 2, abs=1e-8)
        sheet = outline(face) - [*AT_M, HEIGHT_M]
        assert np.abs(sheet @ [-y, x, 0]).max() <= wide / 2 - MARGIN_M + 1e-8
        assert np.abs(sheet[:, 2]).max() <= TALL_M / 2 - MARGIN_M + 1e-8
        assert sheet.mean(axis=0) == pytest.approx(np.array([x, y, 0]) * out / 2, abs=1e-8)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("body", [["--box", "0.3x0.3"], ["--planes"], ["--board"]])
def test_faces_stand_upright_and_are_not_mirrored(
    tmp_path: Path, body: list[str], pattern: str
) -> None:
    for face in made(tmp_path, *body, "--pattern", pattern).faces:
        rotation = face.base_from_face.rotation
        assert rotation[:, 1] == pytest.approx([0, 0, -1], abs=1e-9)
        # To the right of who looks at it: his left hand is where z × (his way of looking) points.
        right = np.cross(-normal(face), [0, 0, 1])
        assert rotation[:, 0] == pytest.approx(right, abs=1e-9)
        assert outline(face).mean(axis=0)[2] == pytest.approx(0.4, abs=1e-9)


@pytest.mark.parametrize(
    ("pattern", "size"),
    [("checkerboard", ["9", "7", "0.0285"]), ("charuco", ["5", "4", "0.06"])],
)
def test_planes_are_the_papers(tmp_path: Path, pattern: str, size: list[str]) -> None:
    columns, rows, square = size
    board = ["--columns", columns, "--rows", rows, "--square", square, "--sheet", "A3"]
    target = made(tmp_path, "--planes", "--pattern", pattern, *board, "--height", "0.72")
    papers = target_of(pattern)
    for face, expected in zip(target.faces, papers.faces, strict=True):
        assert face.translation == expected.translation
        assert face.quaternion == expected.quaternion
        assert face.corners == pytest.approx(expected.corners)
        assert face.first_marker == expected.first_marker


def test_single_board_looks_where_it_is_told(tmp_path: Path) -> None:
    [face] = made(tmp_path, "--board", "--sides", "left", "--at", "0.2,0").faces
    assert normal(face) == pytest.approx([0, 1, 0], abs=1e-9)
    assert outline(face).mean(axis=0) == pytest.approx([0.2, 0, 0.4], abs=1e-9)


def test_chosen_sides_are_in_the_order_given(tmp_path: Path) -> None:
    faces = made(tmp_path, "--box", "0.3x0.3", "--sides", "right,front").faces
    assert [normal(face).round(9).tolist() for face in faces] == [[0, -1, 0], [1, 0, 0]]


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("body", [["--box", "0.3x0.3"], ["--planes"], ["--board"]])
@pytest.mark.parametrize("sheet", ["A4", "A3"])
def test_what_is_written_passes_the_check_and_fits_on_its_paper(
    tmp_path: Path, cli: Cli, body: list[str], pattern: str, sheet: str
) -> None:
    file = tmp_path / "target.toml"
    words = [*body, "--pattern", pattern, "--sheet", sheet, "--out", file]
    said = cli("target", "make", *words).out.splitlines()
    target, pages = load_target(file), [line for line in said if line.startswith("  page")]
    assert len(pages) == len(target.faces)
    assert all(f", {sheet} " in line or ", A4 " in line for line in pages)
    assert (tmp_path / "target.pdf").read_bytes().count(b"/Type /Page\n") == len(target.faces)
    found = json.loads(cli("target", "check", "--json", file).out)
    assert found["problems"] == []
    assert not any("both ends" in note for note in found["notes"])


def test_squares_are_as_large_as_the_paper_and_the_box_allow(tmp_path: Path) -> None:
    wide = made(tmp_path / "wide", "--box", "0.3x0.3").faces[0]
    assert (wide.columns, wide.rows, wide.square, wide.marker) == (5, 6, 0.038, 0.0285)
    # Of 10 cm 2 cm are white: five squares of 16 mm.
    assert made(tmp_path / "small", "--box", "0.1x0.1").faces[0].square == 0.016
    asked = made(tmp_path / "asked", "--board", "--columns", "4", "--square", "0.02").faces[0]
    assert (asked.columns, asked.rows) == (4, 12)  # 259 mm of A4


def test_dictionary_is_the_smallest_with_a_marker_for_every_square(tmp_path: Path) -> None:
    small = made(tmp_path / "a", "--board")
    large = made(tmp_path / "b", "--planes", "--columns", "8", "--rows", "8")
    assert (small.faces[0].dictionary, large.faces[0].dictionary) == ("DICT_4X4_50", "DICT_4X4_250")
    assert [face.first_marker for face in large.faces] == [0, 32, 64, 96, 128, 160]


def test_file_that_exists_is_kept_unless_forced(tmp_path: Path, cli: Cli) -> None:
    file, pdf = tmp_path / "target.toml", tmp_path / "target.pdf"
    pdf.write_text("mine")
    assert f"{pdf} exists already; add --force" in cli.refused(
        "target", "make", "--box", "0.3x0.3", "--out", str(file)
    )
    assert not file.exists()
    assert made(tmp_path, "--board", "--force").name == "board"
    before = file.read_bytes()
    assert f"{file} exists already" in cli.refused(
        "target", "make", "--box", "0.3x0.3", "--out", str(file)
    )
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "one of: --box 0.30x0.30"),
        (["--box", "0.3x0.3", "--planes"], "one of: --box 0.30x0.30"),
        (["--box", "30x30"], "in metres: 0.30x0.40"),
        (["--box", "0.3"], "in metres: 0.30x0.40"),
        (["--box", "nanx0.3"], "in metres: 0.30x0.40"),
        (["--box", "0.3x0.3", "--height", "0.1"], "greater --height"),
        (["--board", "--height", "0.05"], "into the floor"),
        (["--board", "--height", "nan"], "--height is nan"),
        (["--board", "--at", "10"], "--at is «10»"),
        (["--board", "--sides", "front,left"], "a single board looks to one side"),
        (["--planes", "--sides", "left"], "leave it out with --planes"),
        (["--box", "0.3x0.3", "--sides", "rigth"], "did you mean «right»?"),
        (["--box", "0.3x0.3", "--square", "0.08"], "room for 190 x 259 mm"),
        (["--box", "0.03x0.03"], "no charuco fits: there is room for 10 x 10 mm"),
        (["--board", "--columns", "9", "--rows", "9", "--pattern", "checkerboard"], "four sides"),
        (["--planes", "--columns", "30", "--rows", "20"], "6 boards of 30 x 20 need 1800 markers"),
    ],
)
def test_what_cannot_be_made_is_one_clear_line(
    tmp_path: Path, cli: Cli, words: list[str], message: str
) -> None:
    assert message in cli.refused(
        "target", "make", *words, "--out", str(tmp_path / "x" / "target.toml")
    )
    assert not (tmp_path / "x").exists()


@pytest.fixture
def made_box(tmp_path: Path) -> Target:
    """A box with squares that the lab's cameras can read."""
    return made(tmp_path, "--box", "0.36x0.4x0.3", "--height", "0.7", "--sheet", "A3")


def test_cameras_pictures_show_the_box_as_its_file_says(
    tmp_path: Path,
    made_box: Target,
    monkeypatch: pytest.MonkeyPatch,
    cli: Cli,
) -> None:
    monkeypatch.setattr(world_module, "target_of", lambda _: made_box)
    world = load_world("lab", seed=3)
    renderer, times_s = CameraRenderer(world, "c2"), np.arange(12.0, 16.0, 0.25)
    for number, t_s in enumerate(times_s):
        cv2.imwrite(str(tmp_path / f"{number:03d}.png"), renderer.picture_at(float(t_s)))
    pictures = sorted(map(str, tmp_path.glob("*.png")))
    said = cli("detect", *pictures, "--target", tmp_path / "target.toml", "--json").out
    errors, faces = [], set()
    for t_s, line in zip(times_s, said.splitlines(), strict=True):
        truth = {seen.face.id: seen for seen in world.seen("c2", "r1", float(t_s))}
        for found in json.loads(line)["faces"]:
            seen = truth[found["face"]]
            faces.add(found["face"])
            places = dict(zip(seen.corners, seen.pixels, strict=True))
            errors += [
                math.dist(places[corner], pixel)
                for corner, pixel in zip(found["corners"], found["pixels"], strict=True)
                if corner in places
            ]
    assert len(faces) >= 2
    assert len(errors) > 200
    assert np.median(errors) < 0.05
    assert np.max(errors) < 0.5


def test_session_with_the_box_is_calibrated(
    tmp_path: Path, made_box: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world_module, "target_of", lambda _: made_box)
    world, session = load_world("loop", seed=3), tmp_path / "session"
    write_session(world, session)
    assert load_target(session / "target.toml") == made_box
    assert run(["calibrate", str(session), "--out", str(tmp_path / "out")]) == 0
    network = load_network(tmp_path / "out" / "network.json")
    for name, camera in world.cameras.items():
        found = network.cameras[name]
        assert found.map_from_camera is not None, name
        error_m = found.map_from_camera.pose.translation - camera.map_from_camera.translation
        assert np.linalg.norm(error_m) < 4 * found.position_sigma < 0.4
