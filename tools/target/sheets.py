"""Sheets of paper that a face is printed on, and the room for a pattern on each."""

from collections.abc import Iterator
from enum import StrEnum

from msgspec import Struct

from trigpoint.site.target import Face
from trigpoint.tools.shapes.bodies import print_size

MARGIN_MM = 10.0
HEAD_MM = 12.0
FOOT_MM = 26.0
BAR_MM = 100.0
_EQUAL_MM = 1e-6


class Paper(StrEnum):
    """ISO 216's sizes."""

    A4 = "A4"
    A3 = "A3"
    A2 = "A2"
    A1 = "A1"
    A0 = "A0"


SIZES_MM = {
    Paper.A4: (210.0, 297.0),
    Paper.A3: (297.0, 420.0),
    Paper.A2: (420.0, 594.0),
    Paper.A1: (594.0, 841.0),
    Paper.A0: (841.0, 1189.0),
}


class Sheet(Struct, frozen=True):
    """A page: its name for people, and its size in millimetres."""

    name: str
    width_mm: float
    height_mm: float

    @property
    def room_m(self) -> tuple[float, float]:
        """Width and height that a pattern may have on it, metres."""
        return (self.width_mm - 2 * MARGIN_MM) / 1000, (self.height_mm - HEAD_MM - FOOT_MM) / 1000


def sheets(paper: Paper) -> tuple[Sheet, Sheet]:
    short, long = SIZES_MM[paper]
    return Sheet(f"{paper} upright", short, long), Sheet(f"{paper} lying", long, short)


def sheet_for(face: Face) -> Sheet:
    """The smallest of A4 … A0, portrait or landscape, that fits the face; else a custom size."""
    pattern_mm, height_mm = (1000 * side - _EQUAL_MM for side in print_size(face))
    width_mm = max(pattern_mm, BAR_MM) + 2 * MARGIN_MM
    height_mm += HEAD_MM + FOOT_MM
    for sheet in _all_sheets():
        if width_mm <= sheet.width_mm and height_mm <= sheet.height_mm:
            return sheet
    return Sheet(f"{width_mm:.0f} × {height_mm:.0f} mm", width_mm, height_mm)


def _all_sheets() -> Iterator[Sheet]:
    for paper in Paper:
        yield from sheets(paper)
