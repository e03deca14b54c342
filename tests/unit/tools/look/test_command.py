"""The command `look` on folders of pictures: what it says, the lens that it takes, where it is
written."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.commands import Cli, Said
from support.pictures.boards import (
    CAMERA,
    CHARUCO_TARGET,
    charuco,
    held_pictures,
    picture_of,
    placed,
    write_pictures,
)
from support.site.visitor import Visitor

from trigpoint.site.camera_info import read_camera_info, write_camera_info


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a board, held in eight ways."""
    return write_pictures(tmp_path_factory.mktemp("look") / "shots", held_pictures())


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with the board's target file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "target.toml").write_text(CHARUCO_TARGET)
    return tmp_path


def look(cli: Cli, *words: object, rate: float = 200, status: int = 0) -> Said:
    return cli("look", *words, "--no-page", "--rate", rate, status=status)


def test_it_takes_the_lens_that_intrinsics_takes(shots: Path, here: Path, cli: Cli) -> None:
    said = look(cli, shots).out
    assert "picture 1: corners 12 on face 0 of target «box»; a square " in said
    assert "lens not known yet" in said
    assert "8 pictures, 8 with the target; 8 views kept" in said
    assert "wrote c1.yaml" in said
    cli("intrinsics", shots, "--target", "target.toml", "--out", "other.yaml")
    found, other = read_camera_info(here / "c1.yaml"), read_camera_info(here / "other.yaml")
    assert np.allclose(found.parameters, other.parameters, rtol=1e-3, atol=1e-3)
    assert found.fx == pytest.approx(CAMERA.fx, rel=0.02)
    assert (here / "c1.html").read_text().startswith("<!doctype html>")


def test_the_result_is_one_object_and_lines_go_beside_it(shots: Path, here: Path, cli: Cli) -> None:
    (here / "door.yaml").write_text("another's")
    captured = look(cli, shots, "--json", "--out", "door.yaml", "--overwrite")
    record = json.loads(captured.out)
    assert "picture 1: corners 12" in captured.err
    assert (record["width"], record["height"], record["pictures"]) == (640, 480, 8)
    assert record["source"] == f"dir://{shots}"
    assert record["with_target"] == record["views"] == 8
    assert record["written"] == ["door.yaml", "door.html"]
    assert record["lens"]["intrinsics"]["sigma"]["fx"] > 0
    assert record["missing"] == ""
    assert "camera_name: door" in (here / "door.yaml").read_text()
    assert read_camera_info(here / "door.yaml").width == 640


def test_nothing_is_overwritten_unsaid(shots: Path, here: Path, cli: Cli) -> None:
    (here / "c1.yaml").write_text("mine")
    said = look(cli, shots, "--out", "c1.yaml", status=2).err
    assert "c1.yaml is there already; give another --out, or --overwrite" in said
    look(cli, shots)
    assert (here / "c1.yaml").read_text() == "mine"
    assert read_camera_info(here / "c2.yaml").width == 640


def test_a_lens_that_is_known_is_held_against_the_pictures_and_none_is_taken(
    shots: Path, here: Path, cli: Cli
) -> None:
    write_camera_info(here / "true.yaml", CAMERA, "true")
    said = look(cli, shots, "--intrinsics", "true.yaml").out
    fits = said.split("lens known, given; it fits this picture to ")[1].split(" px")[0]
    assert float(fits) < 0.2
    assert sorted(path.name for path in here.glob("c*")) == []


def test_a_lens_of_another_size_is_refused(shots: Path, here: Path, cli: Cli) -> None:
    write_camera_info(here / "large.yaml", CAMERA, "large")
    larger = (here / "large.yaml").read_text().replace("image_width: 640", "image_width: 1280")
    (here / "large.yaml").write_text(larger)
    said = look(cli, shots, "--intrinsics", "large.yaml", status=2).err
    assert "are 640 × 480, but its intrinsics are for 1280 × 480" in said


def test_what_the_target_file_has_wrong_is_said_as_detect_says_it(
    shots: Path, here: Path, cli: Cli
) -> None:
    wrong = CHARUCO_TARGET.replace("columns = 5", "columns = 4").replace("rows = 4", "rows = 5")
    (here / "target.toml").write_text(wrong)
    said = cli("detect", shots, "--target", "target.toml").err
    hint = said.splitlines()[0].removeprefix("target.toml: ")
    assert "write columns = 5 and rows = 4" in hint
    captured = look(cli, shots, status=1)
    assert hint in captured.out
    assert "no lens was taken, so nothing is written: face 0" in captured.err


def test_what_the_views_leave_open_is_said_and_nothing_is_written(here: Path, cli: Cli) -> None:
    views = [placed(charuco(), x=-0.1 + 0.05 * number, distance=0.7) for number in range(5)]
    pictures = (picture_of([view], noise=2.0, seed=n) for n, view in enumerate(views))
    write_pictures(here / "flat", pictures)
    captured = look(cli, "flat", status=1)
    assert "focal length: the board was never tilted" in captured.err
    assert "tilt the board now: its " in captured.out
    assert not list(here.glob("*.yaml"))


def test_an_endless_source_is_looked_at_for_so_long(here: Path, cli: Cli) -> None:
    """The world has ended and its robot stands: there is one view, however long it takes."""
    words = ["sim://c2?world=lab&seed=1&epoch_ns=0", "--target", "charuco", "--seconds", "3"]
    captured = look(cli, *words, rate=10, status=1)
    assert "lens known, by the source; it fits this picture to 0.0" in captured.out
    assert "no lens was taken" in captured.err


def test_the_page_of_a_folder_stays_until_it_is_stopped(shots: Path, here: Path) -> None:
    """A folder is looked through before anybody has opened its page."""
    words = [sys.executable, "-m", "trigpoint", "look", str(shots), "--port", "0", "--rate", "200"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as looking:
        assert looking.stdout is not None
        try:
            said = []
            for line in looking.stdout:
                said.append(line)
                if "stays" in line:
                    break
            assert said[-1] == "it has ended; the lens is in c1.yaml; the page stays until Ctrl-C\n"
            with Visitor(said[0].split()[-1]).events() as told:
                assert next(told)["over"] == "it has ended; the lens is in c1.yaml"
        finally:
            looking.send_signal(signal.SIGINT)
    assert looking.returncode == 0


def test_pictures_of_two_sizes_are_no_cameras(here: Path, cli: Cli) -> None:
    write_pictures(here / "mixed", (np.full((48, side), 99, np.uint8) for side in (64, 65)))
    assert "1.png is 65 × 48, those before were 64 × 48" in look(cli, "mixed", status=2).err


@pytest.mark.parametrize(
    ("sides", "count", "first"),
    [
        ((64, 65, 64, 64), "1 picture", "1.png is 65 × 48"),
        ((64, 64, 64, 65), "1 picture", "3.png is 65 × 48"),
        ((64, 65, 64, 66, 64), "2 pictures", "1.png is 65 × 48, …"),
    ],
)
def test_pictures_of_another_size_are_left_out_of_a_folder_and_said_once(
    here: Path, cli: Cli, sides: tuple[int, ...], count: str, first: str
) -> None:
    write_pictures(here / "mixed", (np.full((48, side), 99, np.uint8) for side in sides))
    out = look(cli, "mixed", status=1).out
    assert f"{count} left out, not of the size of the first (64 × 48): {first}\n" in out
    assert out.count("left out") == 1


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["none"], 2, "none: there is no such video or folder"),
        (["ftp://camera"], 2, "pictures from «ftp://» are not known here"),
        (["dir://none"], 2, "there is no such folder"),
        (["v4l2:///dev/video99"], 1, "/dev/video99: there is no such camera"),
        (["shots", "--size", "large"], 2, "give width and height in pixels"),
        (["shots", "--out", "c1.txt"], 2, "end the name in .yaml"),
        (["shots", "--target", "board"], 2, "name charuco, checkerboard"),
        (["shots", "--intrinsics", "none.yaml"], 2, "none.yaml: there is no such"),
        (["shots", "--seconds", "0"], 2, "--seconds"),
        (["target.toml"], 2, "this is no video that can be read"),
    ],
)
def test_what_cannot_be_looked_at_is_said_in_one_line(
    shots: Path,
    words: list[str],
    status: int,
    said: str,
    cli: Cli,
) -> None:
    given = [str(shots) if word == "shots" else word for word in words]
    error = look(cli, *given, status=status).err
    assert said in error
    assert len(error.strip().splitlines()) == 1
