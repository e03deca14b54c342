"""Pictures in which nothing of the target is found: the board that they show is named."""

import re
from pathlib import Path

import numpy as np
import pytest
from support.commands import Cli
from support.pictures.boards import aprilgrid, charuco, checkerboard
from support.wrong_inputs.targets import shots, write_shots, write_target

from trigpoint.site.target import Face
from trigpoint.tools.pictures.unlike import greys_seen, squares_seen


@pytest.mark.parametrize("described", [charuco(), checkerboard(6, 9), aprilgrid()])
def test_board_that_is_seen_in_place_of_the_targets_is_named(
    described: Face, tmp_path: Path, cli: Cli
) -> None:
    pictures = write_shots(tmp_path, shots(checkerboard(8, 6), np.random.default_rng(3), 10))
    target = write_target(tmp_path, described)
    said = "10 of the first pictures show a board of 8 × 6 squares"
    assert said in cli("detect", pictures, "--target", target).err
    out = tmp_path / "lens.yaml"
    assert said in cli("intrinsics", pictures, "--target", target, "--out", out, status=1).err


@pytest.mark.parametrize("cut_px", [180, 220, 260])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_board_behind_what_stands_before_the_camera_is_none(seed: int, cut_px: int) -> None:
    """What is left of it is whole, too, and of one size in several pictures."""
    pictures = shots(checkerboard(8, 6), np.random.default_rng(seed), 10)
    for picture in pictures:
        picture[:, :cut_px] = 120
    assert squares_seen(pictures) == ""


def test_board_that_is_cut_now_here_now_there_is_none() -> None:
    """Its parts are of other sizes each time."""
    whole = shots(checkerboard(9, 7), np.random.default_rng(3), 6)
    parts = []
    for number, picture in enumerate(whole):
        part = picture.copy()
        part[:, : 130 + 45 * number] = 120
        parts.append(part)
    assert squares_seen(parts) == ""
    assert squares_seen(whole) == "6 of the first pictures show a board of 9 × 7 squares"


def test_pictures_of_all_but_one_grey_are_said_to_be_so(tmp_path: Path, cli: Cli) -> None:
    """As behind a cap, or exposed for a hundredth of what they need."""
    dark = [picture // 20 for picture in shots(charuco(), np.random.default_rng(3), 10)]
    pictures, target = write_shots(tmp_path, dark), write_target(tmp_path, charuco())
    said = r"within 1\d of 255 greys, from \d in .* to 1\d in the brightest; see to .*exposure"
    assert re.search(said, cli("detect", pictures, "--target", target).err)
    out = tmp_path / "lens.yaml"
    err = cli("intrinsics", pictures, "--target", target, "--out", out, status=1).err
    assert re.search(said, err)
    bright = [np.full_like(picture, 120) for picture in dark[:9]]
    assert greys_seen([*bright, shots(charuco(), np.random.default_rng(3), 1)[0]]) == ""


def test_pictures_of_one_grey_each_are_said_to_span_what_one_of_them_does() -> None:
    """Not what all of them do together, nor without the few pixels that are left aside."""
    steps = np.linspace(0, 1, 10_000).reshape(100, 100)
    pictures = [
        np.rint(low + (high - low) * steps).astype(np.uint8)
        for low, high in ((2, 10), (120, 140), (200, 220))
    ]
    pictures[0][0, :5] = 255
    said = greys_seen(pictures)
    assert "998 of 1000 pixels lie within 20 of 255 greys, from 2 in" in said
    assert "to 220 in the brightest" in said
