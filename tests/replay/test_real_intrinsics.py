"""Lenses from real pictures, beside the figures that were published with them."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import REAL_DATA
from support.pictures.boards import target_of

from trigpoint.cli import run
from trigpoint.edge.lens.calibration import calibrate
from trigpoint.geometry.camera import LensModel
from trigpoint.site.target import NOWHERE, Face, Pattern
from trigpoint.tools.pictures.intrinsics_search import Searched, search

FISHEYE = REAL_DATA / "boards" / "camodocal"
ARM, VIDEO = REAL_DATA / "charuco-arm", REAL_DATA / "charuco-video"
FACE = """\
name = "board"
[[faces]]
id = 0
pattern = "charuco"
translation = [0.0, 0.0, 0.0]
quaternion = [0.0, 0.0, 0.0, 1.0]
"""
ARM_FACE = (
    'columns = 5\nrows = 7\nsquare = 0.036195\nmarker = 0.018256\ndictionary = "DICT_6X6_250"'
)
VIDEO_FACE = (
    "columns = 4\nrows = 5\nsquare = 0.054\nmarker = 0.0405\n"
    'dictionary = "DICT_4X4_1000"\ninverted = true'
)


def record(
    pictures: Path, face: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> dict[str, Any]:
    (folder / "target.toml").write_text(f"{FACE}{face}\n")
    words = ["intrinsics", str(pictures), "--target", str(folder / "target.toml"), "--json"]
    assert run(words) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.skipif(not ARM.is_dir(), reason=f"the real pictures of {ARM.name} are not here")
def test_lens_of_the_arms_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = record(ARM, ARM_FACE, tmp_path, capsys)
    lens, sigma = found["intrinsics"], found["intrinsics"]["sigma"]
    assert len(found["used"]) >= 14
    # Published without distortion, which this lens has: so not within sigmas, but close.
    assert lens["k"][0] == pytest.approx(1352.03, rel=0.01)
    assert lens["k"][4] == pytest.approx(1356.14, rel=0.01)
    assert 1 < sigma["fx"] < 10


@pytest.mark.skipif(not VIDEO.is_dir(), reason=f"the real videos of {VIDEO.name} are not here")
def test_lens_of_a_video_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = record(VIDEO / "cam_2.mp4", VIDEO_FACE, tmp_path, capsys)
    lens, sigma = found["intrinsics"], found["intrinsics"]["sigma"]
    published = tomllib.loads((VIDEO / "camera_array.toml").read_text())["cameras"]["2"]["matrix"]
    # Published from pictures of its own, better spread over the view than these.
    assert abs(lens["k"][0] - published[0][0]) < 5 * sigma["fx"]
    assert abs(lens["k"][4] - published[1][1]) < 5 * sigma["fy"]


@pytest.fixture(scope="module")
def fisheye_views() -> Searched:
    if not FISHEYE.is_dir():
        pytest.skip(f"the real pictures of {FISHEYE.name} are not here")
    face = Face(0, Pattern.CHECKERBOARD, 10, 7, 0.03, *NOWHERE)
    return search([FISHEYE], [target_of(face)], jobs=1)


def test_fisheye_lens_is_found_from_every_picture_that_shows_the_board(
    fisheye_views: Searched,
) -> None:
    found = calibrate(fisheye_views.views, fisheye_views.size)
    assert len(found.used) >= 60
    assert found.camera.model is LensModel.EQUIDISTANT
    assert found.fit.rms_px / np.sqrt(2) <= 0.25
    assert found.doubts == ()


def test_halves_of_a_real_set_agree_within_two_sigmas(fisheye_views: Searched) -> None:
    first, second = (calibrate(fisheye_views.views[half::2], fisheye_views.size) for half in (0, 1))
    assert first.camera.model is second.camera.model is LensModel.EQUIDISTANT
    apart = first.camera.parameters - second.camera.parameters
    assert np.all(np.abs(apart) < 2 * np.hypot(first.known.sigma, second.known.sigma))
