"""Picture files and arrays: what is no sound picture is said in one line."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.pictures.boards import checkerboard, picture_of, placed, target_of

from trigpoint.base.errors import InputError
from trigpoint.edge.detector import detector_for
from trigpoint.edge.image.picture import as_grey, depth_words, eight_bits
from trigpoint.edge.sources.picture_files import (
    check_orientations,
    decoded,
    is_picture,
    orientation,
    pictures_in,
    read_picture,
)

PICTURE = picture_of([placed(checkerboard())])


def written(path: Path, picture: np.ndarray = PICTURE) -> Path:
    assert cv2.imwrite(str(path), picture)
    return path


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp", ".tif"])
def test_written_picture_is_read(tmp_path: Path, suffix: str) -> None:
    picture = read_picture(written(tmp_path / f"a{suffix}"))
    assert picture.shape == PICTURE.shape
    assert np.abs(picture.astype(int) - PICTURE).mean() < 3


@given(
    bits=st.integers(8, 16),
    dtype=st.sampled_from([np.uint16, np.int16, np.uint32, np.int32, np.float32, np.float64]),
    channels=st.integers(0, 4),
    is_at_upper_end=st.booleans(),
    side=st.integers(1, 400),
)
def test_picture_of_any_depth_and_channels_is_the_same_in_eight_bits(
    bits: int, dtype: type, channels: int, is_at_upper_end: bool, side: int
) -> None:
    grey = np.ascontiguousarray(PICTURE[:side, :side])
    grey[0] = 255  # more is white than may glare
    bits = min(bits, 15) if dtype is np.int16 else bits
    deep = np.rint(grey / 255.0 * (2**bits - 1)).astype(dtype)
    if is_at_upper_end and dtype is np.uint16:
        deep <<= 16 - bits
    picture = deep if channels == 0 else np.stack([deep] * channels, axis=-1)
    assert np.abs(as_grey(picture).astype(int) - grey).max() <= 1
    assert eight_bits(picture).ndim == (3 if channels > 2 else 2)


@given(
    suffix=st.sampled_from([".png", ".tif", ".pgm", ".jp2", ".exr", "", ".jpg", ".dat", ".JPEG"]),
    kind=st.sampled_from([".png", ".tif", ".jp2", ".pfm", ".hdr"]),
    bits=st.integers(8, 16),
    channels=st.sampled_from([0, 3]),
)
def test_picture_file_of_any_depth_and_suffix_shows_the_same(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, kind: str, bits: int, channels: int
) -> None:
    dtype = np.float32 if kind in (".pfm", ".hdr") else np.uint16
    deep = np.rint(PICTURE / 255.0 * (2**bits - 1)).astype(dtype)
    picture = np.stack([deep] * channels, axis=-1) if channels else deep
    file = tmp_path_factory.getbasetemp() / f"drawn{suffix}"
    file.write_bytes(cv2.imencode(kind, picture)[1].tobytes())
    assert is_picture(file)
    assert np.abs(as_grey(read_picture(file)).astype(int) - as_grey(deep)).max() <= 3


def test_real_numbers_are_scaled_and_what_is_no_number_is_black() -> None:
    shares = PICTURE.astype(np.float32) / 255
    shares[:2] = np.nan
    shares[5, 5], shares[6, 6] = 40.0, np.inf  # glints
    assert np.abs(as_grey(shares)[7:].astype(int) - PICTURE[7:]).max() <= 1
    assert np.all(as_grey(shares)[:2] == 0)
    assert np.abs(as_grey(PICTURE.astype(float)).astype(int) - PICTURE).max() == 0


def test_hot_pixels_do_not_make_a_picture_black() -> None:
    deep = PICTURE.astype(np.uint16) << 2
    deep[::97, ::89] = 65535
    assert depth_words(deep) == "10 of 16 bits"
    assert np.abs(as_grey(deep).astype(int) - PICTURE)[deep < 1024].max() <= 1


@pytest.mark.parametrize("channels", [2, 4])
def test_alpha_channel_is_left_out(tmp_path: Path, channels: int) -> None:
    clear = np.stack([PICTURE] * channels, axis=-1)
    clear[..., -1] = 7
    assert np.array_equal(as_grey(clear), PICTURE)
    if channels == 4:
        assert np.array_equal(read_picture(written(tmp_path / "clear.png", clear)), PICTURE)


def in_exif(turned: int, order: str = "<") -> bytes:
    """EXIF's block with this orientation alone."""
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8)
    entry = struct.pack(f"{order}HHIHH", 0x112, 3, 1, turned, 0)
    return head + struct.pack(f"{order}H", 1) + entry + bytes(4)


def jpeg_turned(turned: int, order: str = "<") -> bytes:
    data = cv2.imencode(".jpg", PICTURE)[1].tobytes()
    block = b"Exif\0\0" + in_exif(turned, order)
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + data[2:]


def png_turned(turned: int) -> bytes:
    data = cv2.imencode(".png", PICTURE)[1].tobytes()
    chunk = b"eXIf" + in_exif(turned)
    size, check = struct.pack(">I", len(chunk) - 4), struct.pack(">I", zlib.crc32(chunk))
    return data[:33] + size + chunk + check + data[33:]


def test_orientation_turns_a_picture_and_a_set_that_mixes_them_is_refused(tmp_path: Path) -> None:
    kinds = [jpeg_turned(6), jpeg_turned(6, ">"), png_turned(6)]
    for number, data in enumerate(kinds):
        (tmp_path / f"{number}.x").write_bytes(data)
        assert orientation(tmp_path / f"{number}.x") == 6
        assert decoded(data).shape == PICTURE.shape[::-1]
    check_orientations(pictures_in(tmp_path))
    written(tmp_path / "plain.png")
    (tmp_path / "empty.jpg").touch()  # is left out when it is read
    with pytest.raises(InputError, match=r"plain\.png: EXIF .*3 of 6, 1 of 1.*exiftool"):
        check_orientations(pictures_in(tmp_path))


@given(block=st.binary(max_size=60), at=st.integers(0, 60))
def test_damaged_exif_is_no_orientation(
    tmp_path_factory: pytest.TempPathFactory, block: bytes, at: int
) -> None:
    whole = in_exif(3)
    file = tmp_path_factory.getbasetemp() / "damaged.jpg"
    file.write_bytes(b"\xff\xd8Exif\0\0" + whole[: min(at, len(whole))] + block)
    assert orientation(file) in range(1, 9)


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
    (tmp_path / "cam0").mkdir()
    written(tmp_path / "cam0" / "plain.png")
    with pytest.raises(InputError, match=r"but in those in it \(cam0\); name one"):
        pictures_in(tmp_path)
    for number in range(1, 8):
        (tmp_path / f"cam{number}").mkdir()
        written(tmp_path / f"cam{number}" / "plain.png")
    with pytest.raises(InputError, match=r"in it \(cam0, cam1, cam2, cam3, cam4, …\); name one"):
        pictures_in(tmp_path)


def test_pictures_of_a_folder_come_by_name(tmp_path: Path) -> None:
    for name in ("b.png", "a.JPG", "c.txt", ".hidden.png", "e.HEIC"):
        (tmp_path / name).touch()
    written(tmp_path / "plain.png").rename(tmp_path / "d")
    assert [file.name for file in pictures_in(tmp_path)] == ["a.JPG", "b.png", "d", "e.HEIC"]
    assert not is_picture(tmp_path / "c.txt")


@pytest.mark.parametrize(
    ("name", "said"), [("a.heic", "HEIC.*heif-convert"), ("a.jpg", "HEIC"), ("a.NEF", "raw file")]
)
def test_what_opencv_does_not_read_is_named_with_its_remedy(
    tmp_path: Path, name: str, said: str
) -> None:
    (tmp_path / name).write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(99))
    with pytest.raises(InputError, match=said):
        read_picture(tmp_path / name)


@pytest.mark.parametrize(
    ("array", "said"),
    [
        (np.zeros((480, 640), np.complex64), "complex64"),
        (np.zeros((480, 640, 5), np.uint8), "5 channels"),
        (np.zeros((0, 640), np.uint8), "no picture"),
        (np.zeros((480, 0, 3), np.uint8), "no picture"),
        (np.zeros(100, np.uint8), "no picture"),
    ],
)
def test_detector_refuses_what_is_no_picture(array: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        detector_for([target_of(checkerboard())]).detect(array)
