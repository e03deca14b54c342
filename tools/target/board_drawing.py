"""A face as the target file describes it, drawn for the terminal or as a picture.

Held beside the board, it shows whether columns, rows and colours are those of the file.
"""

from pathlib import Path

import cv2
import numpy as np
import typer

from trigpoint.base.errors import OperationError
from trigpoint.edge.registration.printed_pattern import charuco_layout
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Numbering, Pattern, Target

from .pattern import black_rectangles, described

BLACK, WHITE = "##", "  "
_PICTURE_SIDE_PX = 900
_MARGIN_PX = 60
_CORNER_BGR = (40, 40, 220)
_LEAST_LABEL_PX = 16.0


def terminal_drawing(face: Face) -> str:
    """The face as its viewer sees it upright: «##» is black, and on a terminal it looks so; a
    marker is a number, black upon white."""
    rows = _grid_of_tags(face) if face.pattern is Pattern.APRILGRID else _squares(face)
    head = f"face {face.id}: {described(face)}; upright, «{BLACK}» is black"
    return "\n".join([head, *("  " + "".join(map(_coloured, row)) for row in rows)])


def _coloured(cell: str) -> str:
    """Coloured text on a terminal, plain text elsewhere."""
    is_black = cell.strip("#") == ""
    colours = ("black", "black") if is_black and cell.strip() else ("black", "bright_white")
    return typer.style(cell, fg=colours[0], bg=colours[1])


def _squares(face: Face) -> list[list[str]]:
    """A checkerboard or a ChArUco board, one cell per square."""
    row, column = np.indices((face.rows, face.columns))
    numbers = _marker_numbers(face)
    is_black = (row + column) % 2 == int(face.inverted)
    if numbers:
        x, y = next(iter(numbers))
        # Markers are in the light squares; in the dark ones of an inverted board.
        is_black = ((row + column) % 2 == (x + y) % 2) == face.inverted
    width = max([2, *(len(str(number)) for number in numbers.values())])
    return [
        [
            f"{numbers[x, y]:>{width}}"
            if (x, y) in numbers
            else (BLACK if black else WHITE)[0] * width
            for x, black in enumerate(line)
        ]
        for y, line in enumerate(is_black.tolist())
    ]


def _marker_numbers(face: Face) -> dict[tuple[int, int], int]:
    """Marker ids by the column and row of their square."""
    if face.pattern is not Pattern.CHARUCO:
        return {}
    places = np.floor(charuco_layout(face).mean(axis=1) / face.square).astype(int) + 1
    return {(x, y): face.first_marker + i for i, (x, y) in enumerate(places.tolist())}


def _grid_of_tags(face: Face) -> list[list[str]]:
    """Tags with their ids, and the squares between them."""
    width = max(2, len(str(face.first_marker + face.marker_count - 1)))
    gap = BLACK if face.has_corner_squares else WHITE
    between = [*([gap, WHITE[0] * (width + 2)] * face.columns), gap]
    lines = [between]
    for row in range(face.rows):
        counted = face.rows - 1 - row if face.numbering is Numbering.KALIBR else row
        first = face.first_marker + counted * face.columns
        tags = [f"[{first + column:>{width}}]" for column in range(face.columns)]
        lines += [[part for tag in tags for part in (WHITE, tag)] + [WHITE], between]
    return lines


def write_drawings(target: Target, path: Path) -> list[Path]:
    """One picture per face, numbered if there are several; raises OperationError."""
    several = len(target.faces) > 1
    files = [path.with_stem(f"{path.stem}_{face.id}") if several else path for face in target.faces]
    for face, file in zip(target.faces, files, strict=True):
        try:
            is_written = cv2.imwrite(str(file), face_picture(face))
        except cv2.error:
            is_written = False
        if not is_written:
            raise OperationError(f"{file} cannot be written; choose another name, ending in .png")
    return files


def face_picture(face: Face) -> np.ndarray:
    """A face upright with its corners and some of their ids, (h, w, 3) BGR."""
    low, high = face.outline.min(axis=0)[:2], face.outline.max(axis=0)[:2]
    scale = _PICTURE_SIDE_PX / float(np.max(high - low))
    width, height = np.ceil((high - low) * scale).astype(int) + 2 * _MARGIN_PX
    picture = np.full((int(height), int(width), 3), 255, np.uint8)
    for x, y, w, h in black_rectangles(face):
        first, last = (
            np.rint((np.array(place) - low) * scale + _MARGIN_PX).astype(int)
            for place in ((x, y), (x + w, y + h))
        )
        picture[first[1] : last[1], first[0] : last[0]] = 0
    _draw_corners(picture, (face.corners[:, :2] - low) * scale + _MARGIN_PX)
    _write(picture, f"face {face.id}: {described(face)}", (_MARGIN_PX, 24))
    _write(picture, "up ^", (int(width) // 2, _MARGIN_PX - 12))
    return picture


def _draw_corners(picture: np.ndarray, places: Array) -> None:
    """A dot at every corner; ids if there is room, otherwise only the first one's."""
    side = float(np.min(np.linalg.norm(places[1:] - places[:-1], axis=1)))
    labelled = len(places) if side > 2 * _LEAST_LABEL_PX else 1
    for number, (x, y) in enumerate(np.rint(places).astype(int).tolist()):
        cv2.circle(picture, (x, y), 3, _CORNER_BGR, -1, cv2.LINE_AA)
        if number < labelled:
            _write(picture, str(number), (x + 4, y - 4))


def _write(picture: np.ndarray, text: str, place: tuple[int, int]) -> None:
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(picture, text, place, font, 0.45, _CORNER_BGR, 1, cv2.LINE_AA)
