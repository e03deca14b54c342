"""The command `intrinsics`: from pictures to a lens, its YAML file and its page."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import site_text
from support.commands import Cli
from support.pictures.boards import (
    CAMERA,
    CHARUCO_TARGET,
    HELD,
    Placed,
    charuco,
    held_pictures,
    picture_of,
    placed,
    write_pictures,
)

from trigpoint.site.camera_info import read_camera_info


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a board, a target file, and a site file that names it."""
    made = tmp_path_factory.mktemp("lens")
    (made / "target.toml").write_text(CHARUCO_TARGET)
    (made / "site.toml").write_text(site_text())
    write_pictures(made / "shots", held_pictures(7))
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
    assert page.count('role="img"') == 2


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


X, Y, DISTANCE, TILT, YAW = HELD[0]
FIRST = placed(charuco(), x=X, y=Y, distance=DISTANCE, tilt_deg=TILT, yaw_deg=YAW)
STRAIGHT = [placed(charuco(), x=x, y=y, distance=distance) for x, y, distance, *_ in HELD[:7]]


@pytest.mark.parametrize(
    ("views", "said"),
    [
        ([FIRST] * 6, "6 views of the board show one view of it"),
        (STRAIGHT, "focal length: the board was never tilted"),
        ([placed(charuco(), distance=9.0)] * 4, "no view of the target was found in 4 pictures"),
        ([placed(charuco(first=40))] * 4, "the pictures show a board with first_marker = 40, or"),
    ],
)
def test_pictures_that_determine_no_lens_make_no_file(
    folder: Path, tmp_path: Path, cli: Cli, views: list[Placed], said: str
) -> None:
    pictures = (picture_of([view], noise=2.0, seed=seed) for seed, view in enumerate(views))
    shots, out = write_pictures(tmp_path / "shots", pictures), tmp_path / "made" / "c1.yaml"
    words = ("intrinsics", shots, "--target", folder / "target.toml", "--out", out)
    error = cli(*words, status=1).err
    assert said in error
    assert len(error.splitlines()) == 1
    assert not out.parent.exists()
    if views[0] is FIRST:
        assert "not determined: focal length" in cli(*words, "--force").out
        assert read_camera_info(out).width == 640


def test_several_jobs_find_the_same(folder: Path, cli: Cli) -> None:
    words = ["intrinsics", str(folder / "shots"), "--target", str(folder / "target.toml"), "--json"]
    assert cli(*words, "--jobs", 1).out == cli(*words, "--jobs", 2).out
