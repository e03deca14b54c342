"""What a line of `look` may name."""

from pathlib import Path

import pytest
from support.pictures.boards import CHARUCO_TARGET

from trigpoint.base.errors import InputError, TargetError
from trigpoint.site.target import Pattern, parse_target
from trigpoint.tools.look.asked import chosen_target, picture_size, source_url
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.site.file import first_target_text


def test_paths_and_numbers_are_sources_too(tmp_path: Path) -> None:
    video = tmp_path / "drive.mp4"
    video.touch()
    assert source_url("rtsp://door/1") == "rtsp://door/1"
    assert source_url("0") == "v4l2://0"
    assert source_url("/dev/video2") == "v4l2:///dev/video2"
    assert source_url(str(tmp_path)) == f"dir://{tmp_path}"
    assert source_url(str(video)) == f"file://{video}"
    with pytest.raises(InputError, match="there is no such video or folder"):
        source_url(str(tmp_path / "none"))


def test_sizes_are_read() -> None:
    assert picture_size("1280x720") == (1280, 720)
    for text in ("1280", "0x720", "ax720", "1280x720x3", "-1x5"):
        with pytest.raises(InputError, match="like 1280x720"):
            picture_size(text)


def test_charuco_is_what_init_has_printed_and_simulated_robots_carry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert chosen_target("charuco", "v4l2") == parse_target(first_target_text())
    assert chosen_target("charuco", "sim") == target_of("charuco")
    assert chosen_target(None, "rtsp") == parse_target(first_target_text())


def test_the_target_file_that_is_here_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "target.toml").write_text(CHARUCO_TARGET)
    assert chosen_target(None, "sim") == parse_target(CHARUCO_TARGET)


def test_a_checkerboard_is_named_by_its_squares() -> None:
    (face,) = chosen_target("checkerboard:10x7", "dir").faces
    assert (face.pattern, face.columns, face.rows) == (Pattern.CHECKERBOARD, 10, 7)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("checkerboard:10", "like checkerboard:10x7"),
        ("checkerboard:9x9", "make columns and rows differ"),
        ("charruco", "name charuco, checkerboard"),
    ],
)
def test_other_targets_are_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        chosen_target(text, "dir")


def test_a_missing_target_file_is_named() -> None:
    with pytest.raises(TargetError, match=r"none\.toml"):
        chosen_target("none.toml", "dir")
