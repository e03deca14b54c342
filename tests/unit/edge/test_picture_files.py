"""Picture files and arrays: what is no sound picture is said in one line."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from boards import checkerboard, picture_of, placed, target_of

from trigpoint.edge.detector import detector_for
from trigpoint.edge.sources.picture_files import is_picture, pictures_in, read_picture
from trigpoint.errors import InputError

PICTURE = picture_of([placed(checkerboard())])


def written(path: Path, picture: np.ndarray = PICTURE) -> Path:
    assert cv2.imwrite(str(path), picture)
    return path


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp", ".tif"])
def test_written_picture_is_read(tmp_path: Path, suffix: str) -> None:
    picture = read_picture(written(tmp_path / f"a{suffix}"))
    assert picture.shape == PICTURE.shape
    assert np.abs(picture.astype(int) - PICTURE).mean() < 3


def test_sixteen_bits_are_scaled_down(tmp_path: Path) -> None:
    file = written(tmp_path / "deep.png", PICTURE.astype(np.uint16) * 257)
    assert np.abs(read_picture(file).astype(int) - PICTURE).max() <= 1


def test_alpha_channel_is_left_out(tmp_path: Path) -> None:
    clear = cv2.cvtColor(PICTURE, cv2.COLOR_GRAY2BGRA)
    assert read_picture(written(tmp_path / "clear.png", clear)).shape == PICTURE.shape
    assert read_picture(tmp_path / "clear.png", in_colour=True).shape == (480, 640, 3)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.1, 0.6, 0.99])
def test_picture_that_is_cut_short_is_refused(tmp_path: Path, suffix: str, share: float) -> None:
    file = written(tmp_path / f"cut{suffix}")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"cut\..*cut short"):
        read_picture(file)


def test_thumbnail_does_not_hide_that_a_picture_is_cut_short(tmp_path: Path) -> None:
    data = written(tmp_path / "a.jpg").read_bytes()
    small = written(tmp_path / "small.jpg", PICTURE[::4, ::4]).read_bytes()
    header = b"\xff\xe1" + (len(small) + 2).to_bytes(2, "big") + small
    whole = tmp_path / "whole.jpg"
    whole.write_bytes(data[:2] + header + data[2:])
    assert read_picture(whole).shape == PICTURE.shape
    whole.write_bytes(whole.read_bytes()[: -len(data) // 2])
    with pytest.raises(InputError, match="cut short"):
        read_picture(whole)


@pytest.mark.parametrize("data", [b"", b"hello", b"\x00" * 100, b"BM" + b"\xff" * 50])
def test_what_is_no_picture_is_refused(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "no.png"
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"no\.png: this is no picture"):
        read_picture(file)


def test_missing_picture_and_empty_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such picture"):
        read_picture(tmp_path / "none.png")
    with pytest.raises(InputError, match="there is no such folder"):
        pictures_in(tmp_path / "none")
    with pytest.raises(InputError, match="no pictures in this folder"):
        pictures_in(tmp_path)


def test_pictures_of_a_folder_come_by_name(tmp_path: Path) -> None:
    for name in ("b.png", "a.JPG", "c.txt", ".hidden.png"):
        (tmp_path / name).touch()
    assert [file.name for file in pictures_in(tmp_path)] == ["a.JPG", "b.png"]
    assert not is_picture(tmp_path / "c.txt")


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((480, 640), np.uint16), "uint16"),
        (np.zeros((480, 640), np.float32), "float32"),
        (np.zeros((480, 640, 4), np.uint8), "4 channels"),
        (np.zeros((480, 640, 2), np.uint8), "2 channels"),
        (np.zeros((0, 640), np.uint8), "no picture"),
        (np.zeros((480, 0, 3), np.uint8), "no picture"),
        (np.zeros(100, np.uint8), "no picture"),
    ],
)
def test_detector_refuses_what_is_no_picture(array: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        detector_for([target_of(checkerboard())]).detect(array)
