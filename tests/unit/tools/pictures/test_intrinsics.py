"""The command `intrinsics`: from pictures to a lens, its YAML file and its page."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import site_text
from support.commands import Cli
from support.pictures.boards import CAMERA, CHARUCO_TARGET, charuco, picture_of, placed

from trigpoint.cli import run
from trigpoint.site.camera_info import read_camera_info

PLACES = [
    (-0.13, -0.1, 0.62, 30, 20),
    (0.14, -0.09, 0.65, -35, 10),
    (-0.12, 0.1, 0.6, 20, -35),
    (0.12, 0.1, 0.64, -25, -25),
    (0.0, 0.0, 0.5, 40, 0),
    (0.02, 0.01, 0.5, 0, 42),
    (-0.03, 0.0, 0.9, -40, 15),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a board, a target file, and a site file that names it."""
    made = tmp_path_factory.mktemp("lens")
    (made / "target.toml").write_text(CHARUCO_TARGET)
    (made / "site.toml").write_text(site_text())
    (made / "shots").mkdir()
    for number, (x, y, distance, tilt, yaw) in enumerate(PLACES):
        view = placed(charuco(), x=x, y=y, distance=distance, tilt_deg=tilt, yaw_deg=yaw)
        picture = picture_of([view], noise=2.0, seed=number)
        cv2.imwrite(str(made / "shots" / f"{number}.png"), picture)
    return made


def test_lens_is_written_as_ros_reads_it_with_a_page_beside_it(folder: Path, cli: Cli) -> None:
    out = folder / "made" / "c1.yaml"
    words = ["intrinsics", str(folder / "shots"), "--target", str(folder / "target.toml")]
    said = cli(*words, "--out", out).out
    assert "7 pictures, 7 views of the target" in said
    assert f"wrote {out}" in said
    found = read_camera_info(out)
    assert (found.width, found.height) == (640, 480)
    assert found.fx == pytest.approx(CAMERA.fx, rel=0.02)
    page = out.with_suffix(".html").read_text()
    assert page.startswith("<!doctype html>")
    assert "c1: focal length" in page
    assert "http" not in page
    assert page.count('role="img"') == 3


def test_json_tells_the_same_with_sigmas(folder: Path, cli: Cli) -> None:
    words = ["intrinsics", str(folder / "shots"), "--site", str(folder / "site.toml"), "--json"]
    record = json.loads(cli(*words).out)
    lens = record["intrinsics"]
    errors = (np.array(lens["k"])[[0, 4]] - [CAMERA.fx, CAMERA.fy]) / [
        lens["sigma"]["fx"],
        lens["sigma"]["fy"],
    ]
    assert np.all(np.abs(errors) < 5)
    assert len(record["used"]) == 7
    assert "camera_matrix" in record["camera_info"]
    assert not list(folder.glob("*.yaml"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["shots", "--target", "target.toml", "--site", "site.toml"], "two targets are given"),
        (["none", "--target", "target.toml"], "none: there is no such picture"),
        (["shots", "--target", "target.toml", "--out", "lens.txt"], "end the name in .yaml"),
        (["shots", "other.png", "--target", "target.toml"], "1 of 30 × 20 (other.png); give"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    cli: Cli,
    words: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(folder)
    cv2.imwrite("other.png", np.zeros((20, 30), np.uint8))
    error = cli.refused("intrinsics", *words)
    assert said in error
    assert len(error.splitlines()) == 1


def words_of(folder: Path, pictures: list[np.ndarray], out: Path) -> list[str]:
    """A command line for pictures that are written first."""
    place = folder / out.stem
    place.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(place / f"{number}.png"), picture)
    return ["intrinsics", str(place), "--target", str(folder / "target.toml"), "--out", str(out)]


def refused(words: list[str], out: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What is said where no file is written."""
    assert run(words) == 1
    assert not out.exists()
    assert not out.with_suffix(".html").exists()
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    return error


def test_copies_of_one_picture_make_no_file_unless_forced(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x, y, distance, tilt, yaw = PLACES[0]
    view = placed(charuco(), x=x, y=y, distance=distance, tilt_deg=tilt, yaw_deg=yaw)
    pictures = [picture_of([view], noise=2.0, seed=seed) for seed in range(6)]
    out = tmp_path / "copies.yaml"
    words = words_of(folder, pictures, out)
    assert "6 views of the board show one view of it" in refused(words, out, capsys)
    assert run([*words, "--force"]) == 0
    assert read_camera_info(out).width == 640
    assert "not determined: focal length" in capsys.readouterr().out


def test_pictures_of_a_board_that_was_never_tilted_make_no_file(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    views = [placed(charuco(), x=x, y=y, distance=distance) for x, y, distance, *_ in PLACES]
    out = tmp_path / "straight.yaml"
    pictures = [picture_of([view], noise=2.0, seed=seed) for seed, view in enumerate(views)]
    words = words_of(folder, pictures, out)
    assert "focal length: the board was never tilted" in refused(words, out, capsys)


def test_pictures_of_another_board_make_no_file(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = [picture_of([placed(charuco(first=40))], seed=seed) for seed in range(4)]
    out = tmp_path / "other.yaml"
    said = refused(words_of(folder, pictures, out), out, capsys)
    assert "no view of the target was found in 4 pictures" in said


def test_several_jobs_find_the_same(folder: Path, cli: Cli) -> None:
    words = ["intrinsics", str(folder / "shots"), "--target", str(folder / "target.toml"), "--json"]
    assert cli(*words, "--jobs", 1).out == cli(*words, "--jobs", 2).out
