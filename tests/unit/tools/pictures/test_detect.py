"""The command `detect`: what it prints, draws and refuses."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.commands import Cli, Said
from support.pictures.boards import (
    CAMERA,
    CHARUCO_TARGET,
    charuco,
    checkerboard,
    picture_of,
    placed,
    plain_picture,
    worst_error,
)

BOARD = charuco()
VIEW = placed(BOARD, distance=0.8, tilt_deg=15)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "target.toml").write_text(CHARUCO_TARGET)
    shots = tmp_path / "shots"
    shots.mkdir()
    cv2.imwrite(str(shots / "a.png"), picture_of([VIEW]))
    cv2.imwrite(str(shots / "b.png"), plain_picture())
    return tmp_path


def detect(cli: Cli, folder: Path, *words: object, status: int = 0) -> Said:
    return cli("detect", *words, "--target", folder / "target.toml", status=status)


def test_json_is_one_object_a_line_in_the_order_given(folder: Path, cli: Cli) -> None:
    shots = folder / "shots"
    said = detect(cli, folder, shots / "b.png", shots, "--json").out
    lines = [json.loads(line) for line in said.splitlines()]
    assert [Path(line["picture"]).name for line in lines] == ["b.png", "a.png", "b.png"]
    found = lines[1]
    assert set(found) == {"picture", "width", "height", "milliseconds", "faces"}
    assert (found["width"], found["height"], lines[0]["faces"]) == (640, 480, [])
    assert found["milliseconds"] > 0
    (face,) = found["faces"]
    assert set(face) == {"face", "corners", "pixels", "sigma"}
    assert face["face"] == 0
    assert worst_error(np.array(face["pixels"]), np.array(face["corners"]), VIEW) < 0.3


def test_text_says_what_was_found(folder: Path, cli: Cli) -> None:
    first, second = detect(cli, folder, folder / "shots").out.splitlines()
    assert "a.png (640 × 480" in first
    assert "face 0: 12 corners" in first
    assert second.endswith("nothing found")


def test_video_is_taken_picture_by_picture(folder: Path, cli: Cli) -> None:
    clip = folder / "clip.avi"
    size = (CAMERA.width, CAMERA.height)
    writer = cv2.VideoWriter(str(clip), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, size)
    for picture in (plain_picture(), picture_of([VIEW])):
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    said = detect(cli, folder, clip, "--json").out
    lines = [json.loads(line) for line in said.splitlines()]
    assert [line["picture"] for line in lines] == [f"{clip}#0", f"{clip}#1"]
    assert [len(line["faces"]) for line in lines] == [0, 1]


def test_drawings_are_written_without_overwriting_each_other(folder: Path, cli: Cli) -> None:
    shutil.copytree(folder / "shots", folder / "again")
    detect(cli, folder, folder / "shots", folder / "again", "--draw", folder / "drawn")
    names = sorted(file.name for file in (folder / "drawn").iterdir())
    assert names == ["a.png", "a_2.png", "b.png", "b_2.png"]
    drawn = cv2.imread(str(folder / "drawn" / "a.png"))
    assert drawn is not None
    assert drawn.shape == (960, 1280, 3)
    assert np.ptp(drawn.astype(int), axis=-1).max() > 50


def test_a_drawing_that_the_disk_does_not_take_is_an_error(folder: Path, cli: Cli) -> None:
    drawn = folder / "drawn"
    drawn.mkdir()
    (drawn / "a.png").symlink_to("/dev/full")
    said = detect(cli, folder, folder / "shots", "--draw", drawn, status=1)
    assert "a.png: cannot be written (No space left on device); make room" in said.err


@pytest.mark.parametrize(
    ("name", "data", "status", "said"),
    [
        ("none.png", None, 2, "none.png: there is no such picture, folder or video"),
        ("empty.png", b"", 1, "empty.png: this is no picture"),
        ("cut.jpg", b"\xff\xd8\xff\xda" + b"\x00" * 90, 1, "cut.jpg: the picture is cut short"),
        ("notes.txt", b"hello", 1, "notes.txt: this is no video"),
    ],
)
def test_bad_picture_alone_is_one_line(
    folder: Path,
    cli: Cli,
    name: str,
    data: bytes | None,
    status: int,
    said: str,
) -> None:
    if data is not None:
        (folder / name).write_bytes(data)
    error = detect(cli, folder, folder / name, status=status).err
    assert said in error
    assert error.count("\n") == 1


def test_bad_pictures_among_good_ones_are_left_out_counted_and_named(
    folder: Path, cli: Cli
) -> None:
    shots = folder / "shots"
    (shots / "c.png").touch()
    (shots / "d.jpg").write_text("hello")
    (shots / "e.HEIC").write_bytes(b"\0\0\0\x18ftypheic" + bytes(99))
    (shots / "f.png").write_bytes((shots / "a.png").read_bytes()[:-200])
    (shots / "notes.txt").write_text("no picture, and not called one")
    said = detect(cli, folder, shots, "--json")
    assert [len(json.loads(line)["faces"]) for line in said.out.splitlines()] == [1, 0]
    left_out = said.err.splitlines()[0]
    assert left_out.startswith("4 pictures left out: ")
    for words in ("c.png: this is no picture but empty", "d.jpg: ", "heif-convert", "cut short"):
        assert words in left_out
    assert "notes" not in said.err


def test_picture_of_twelve_bits_is_scaled_and_said(folder: Path, cli: Cli) -> None:
    deep = picture_of([VIEW]).astype(np.uint16) * 16
    cv2.imwrite(str(folder / "deep.png"), deep)
    said = detect(cli, folder, folder / "deep.png")
    assert "face 0: 12 corners" in said.out
    assert "deep.png" in said.err
    assert "12 of 16 bits" in said.err


def test_pictures_of_two_sizes_are_no_sequence(folder: Path, cli: Cli) -> None:
    shots = folder / "shots"
    detect(cli, folder, shots, "--sequence")
    cv2.imwrite(str(shots / "c.png"), np.zeros((100, 100), np.uint8))
    assert "c.png: not of the size of" in detect(cli, folder, shots, "--sequence", status=2).err


def test_bad_target_is_one_line_and_status_2(folder: Path, cli: Cli) -> None:
    (folder / "target.toml").write_text(CHARUCO_TARGET.replace("DICT_4X4_250", "DICT_3X3"))
    assert "DICT_3X3" in detect(cli, folder, folder / "shots", status=2).err
    (folder / "target.toml").unlink()
    assert "there is no such target file" in detect(cli, folder, folder / "shots", status=2).err


def test_board_that_the_file_describes_the_wrong_way_round_is_named_once(
    tmp_path: Path, cli: Cli
) -> None:
    picture = picture_of([placed(checkerboard(8, 6), yaw_deg=20)])
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), picture)
    face = 'pattern = "checkerboard"\ncolumns = 6\nrows = 8\nsquare = 0.03\n'
    here = "translation = [0.0, 0.0, 0.0]\nquaternion = [0.0, 0.0, 0.0, 1.0]\n"
    target = tmp_path / "target.toml"
    target.write_text(f'name = "t"\n[[faces]]\nid = 0\n{face}{here}')
    words = [str(tmp_path / name) for name in ("a.png", "b.png")]
    said = cli("detect", *words, "--target", target, "--json")
    assert [json.loads(line)["faces"] for line in said.out.splitlines()] == [[], []]
    assert said.err.count("write columns = 8 and rows = 6") == 1
    assert (
        "write columns = 8 and rows = 6"
        in cli("intrinsics", *words, "--target", target, status=1).err
    )
