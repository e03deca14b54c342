"""Target files that are not of the target in the pictures."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import msgspec
import numpy as np

from trigpoint.geometry.rotation import exp
from trigpoint.site.target import NOWHERE, Face, Pattern
from trigpoint.tools.site.file import toml_value
from trigpoint.tools.target.pattern import black_rectangles

from .case import Case, Kind

WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
SHOTS = 10
_FINER, _TEXELS = 3, 84
_DARK, _LIGHT, _GROUND = 30, 220, 120
_CORNERS = r"face 0: \d+ corners"


def board(
    random: np.random.Generator, pattern: Pattern = Pattern.CHARUCO, *, even_rows: bool = False
) -> Face:
    """A drawn board with more columns than rows, of one parity so that it has an upper side."""
    rows = 4 if even_rows else int(random.integers(4, 6))
    columns = rows + (1 if pattern is Pattern.CHECKERBOARD else int(random.integers(1, 4)))
    plain = {} if pattern is Pattern.CHECKERBOARD else {"marker": 0.03, "dictionary": "DICT_4X4_50"}
    return Face(0, pattern, columns, rows, 0.04, *NOWHERE, **plain)


def changed(face: Face, **changes: object) -> Face:
    return msgspec.structs.replace(face, **changes)


def write_target(folder: Path, face: Face, **lengths: float) -> Path:
    """A file of the face, with other lengths where they are given."""
    keys = {key: value for key, value in msgspec.to_builtins(face).items() if value is not None}
    keys |= lengths
    rows = [f"{key} = {toml_value(value)}" for key, value in keys.items()]
    path = folder / "target.toml"
    path.write_text("\n".join(['name = "board"', "[[faces]]", *rows]) + "\n", encoding="utf-8")
    return path


def shots(face: Face, random: np.random.Generator, count: int = SHOTS) -> list[np.ndarray]:
    """Pictures of the whole board, (480, 640) uint8, from drawn places."""
    sheet, places = _sheet(face)
    return [_shot(sheet, places, random) for _ in range(count)]


def write_shots(folder: Path, pictures: list[np.ndarray]) -> Path:
    path = folder / "pictures"
    path.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(path / f"{number:02d}.png"), picture)
    return path


def _sheet(face: Face) -> tuple[np.ndarray, np.ndarray]:
    """The print with a light margin of half a square, and its corners in the face frame, (4, 2)."""
    margin, scale = face.square / 2, _TEXELS / face.square
    low = face.outline.min(axis=0)[:2] - margin
    high = face.outline.max(axis=0)[:2] + margin
    columns, rows = np.rint((high - low) * scale).astype(int)
    sheet = np.full((rows, columns), _LIGHT, np.uint8)
    for x, y, width, height in black_rectangles(face):
        left, top = np.rint((np.array([x, y]) - low) * scale).astype(int)
        right, bottom = np.rint((np.array([x + width, y + height]) - low) * scale).astype(int)
        sheet[top:bottom, left:right] = _DARK
    return sheet, np.array([low, [high[0], low[1]], high, [low[0], high[1]]])


def _shot(sheet: np.ndarray, places: np.ndarray, random: np.random.Generator) -> np.ndarray:
    flat = np.column_stack([places - places.mean(axis=0), np.zeros(4)])
    turned = flat @ exp(random.uniform(-1, 1, 3) * (0.4, 0.4, 0.15)).T
    size = float(np.max(np.ptp(flat, axis=0)[:2] / (WIDTH, HEIGHT)))
    turned[:, 2] += FOCAL * size / random.uniform(0.6, 0.75)
    pixels = FOCAL * turned[:, :2] / turned[:, 2:] + random.uniform(-30, 30, 2)
    pixels = _FINER * np.add(pixels, (WIDTH / 2, HEIGHT / 2))
    rows, columns = sheet.shape
    texels = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32)
    matrix = cv2.getPerspectiveTransform(texels, pixels.astype(np.float32))
    size = (_FINER * WIDTH, _FINER * HEIGHT)
    fine = cv2.warpPerspective(sheet, matrix, size, borderValue=(_GROUND,))
    picture = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.clip(picture + random.normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8)


def _detected(
    folder: Path, random: np.random.Generator, printed: Face, written: Face, says: str
) -> Case:
    """The board is not published, and the line to write is named."""
    pictures = write_shots(folder, shots(printed, random))
    words = ("detect", pictures, "--target", write_target(folder, written))
    return Case(words, (0, 1), (says,), (_CORNERS,))


def legacy(folder: Path, random: np.random.Generator) -> Case:
    face = board(random, even_rows=True)
    printed = changed(face, legacy=True)
    return _detected(folder, random, printed, face, "legacy")


def other_dictionary(folder: Path, random: np.random.Generator) -> Case:
    face = board(random)
    bits = int(random.integers(5, 8))
    printed = changed(face, dictionary=f"DICT_{bits}X{bits}_{random.choice([50, 100, 250])}")
    return _detected(folder, random, printed, face, f"DICT_{bits}X{bits}")


def exchanged(folder: Path, random: np.random.Generator) -> Case:
    """A checkerboard of an odd side, turned, is the one that is written: nothing would be wrong."""
    pattern = Pattern(random.choice([Pattern.CHARUCO, Pattern.CHECKERBOARD]))
    printed = board(random, pattern)
    if pattern is Pattern.CHECKERBOARD:
        printed = changed(printed, columns=int(random.choice([6, 8])), rows=4)
    written = changed(printed, columns=printed.rows, rows=printed.columns)
    line = rf"columns and rows exchanged|columns = {printed.columns}\b.*rows = {printed.rows}\b"
    return _detected(folder, random, printed, written, line)


def mirrored(folder: Path, random: np.random.Generator) -> Case:
    face = board(random)
    flipped = [picture[:, ::-1] for picture in shots(face, random)]
    words = ("detect", write_shots(folder, flipped), "--target", write_target(folder, face))
    return Case(words, (0, 1), ("mirror",), (_CORNERS, "16H5"))


def inner_corners(folder: Path, random: np.random.Generator) -> Case:
    printed = changed(board(random, Pattern.CHECKERBOARD), columns=int(random.integers(7, 11)))
    written = changed(printed, columns=printed.columns - 1, rows=printed.rows - 1)
    line = rf"columns = {printed.columns}\b.*rows = {printed.rows}\b"
    return _detected(folder, random, printed, written, line)


def units(folder: Path, random: np.random.Generator) -> Case:
    """Lengths of a file in millimetres, which no `Face` takes."""
    face = board(random)
    by = 1000 * random.uniform(0.5, 2.0)
    file = write_target(folder, face, square=face.square * by, marker=(face.marker or 0) * by)
    says = (r"\bmm\b|millimet", r"metres|\bm\b")
    return Case(("target", "check", file), (1, 2), says)


def nothing_like_it(folder: Path, random: np.random.Generator) -> Case:
    """A grid of more tags than some dictionaries have that a hint tries; another board is seen."""
    face = board(random, Pattern.APRILGRID)
    grid = changed(face, columns=6, rows=6, dictionary="DICT_APRILTAG_36h11")
    pictures = write_shots(folder, shots(board(random, Pattern.CHECKERBOARD), random))
    words = ("detect", pictures, "--target", write_target(folder, grid))
    return Case(words, (0, 1), ("target file",), ("needs markers", _CORNERS))


TARGETS: Mapping[str, Kind] = {
    "legacy board": legacy,
    "another dictionary": other_dictionary,
    "columns and rows exchanged": exchanged,
    "mirrored pictures": mirrored,
    "inner corners counted": inner_corners,
    "millimetres for metres": units,
    "another board altogether": nothing_like_it,
}
