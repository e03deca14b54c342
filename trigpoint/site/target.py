"""target.toml: the rigid set of pattern faces on a robot, and where their corners are.

A face's frame has x along a row of corners, y from row to row, z into the board, and its origin at
corner 0; corner numbers and the half turn are defined in the contract.
"""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from trigpoint.base.errors import TargetError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .config import Count, Positive
from .toml_file import load_toml, parse_toml

# No robot carries larger squares, or any so far from its base, and no camera sees smaller ones.
_SMALLEST_SQUARE_M, _LARGEST_SQUARE_M, _FARTHEST_M = 2e-4, 1.0, 20.0
_UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254))
NOWHERE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""Translation and quaternion of a face that has no place yet."""


class Pattern(StrEnum):
    """The kind of pattern printed on a face."""

    CHECKERBOARD = "checkerboard"
    CHARUCO = "charuco"
    APRILGRID = "aprilgrid"


class Numbering(StrEnum):
    """Where counting an AprilGrid's tags starts; row by row, from left to right."""

    TOP_LEFT = "top-left"
    KALIBR = "kalibr"  # from the bottom left, rows upwards


class Face(Struct, frozen=True, forbid_unknown_fields=True):
    """One planar pattern; `translation` and `quaternion` are base_from_face.

    `corner_squares`: whether there are black squares between an AprilGrid's tags; `tags_turned`:
    whether its tags are upside down compared with OpenCV's dictionaries. Kalibr's grids have both,
    so this is the default for drawing; a detector goes by what the picture shows.
    """

    id: Annotated[int, Meta(ge=0)]
    pattern: Pattern
    columns: Count
    rows: Count
    square: Positive
    translation: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    marker: Positive | None = None
    dictionary: str | None = None
    first_marker: Annotated[int, Meta(ge=0)] = 0
    legacy: bool = False
    inverted: bool = False
    border_bits: Count = 1
    numbering: Numbering = Numbering.TOP_LEFT
    corner_squares: bool | None = None
    tags_turned: bool | None = None

    def __post_init__(self) -> None:
        self._check_lengths()
        length = math.hypot(*self.quaternion)
        if abs(length - 1) > 1e-3:
            raise ValueError(f"the quaternion's length is {length:.4f}; it must be 1")
        if self.pattern is Pattern.CHECKERBOARD:
            self._check_checkerboard()
        else:
            self._check_marked()

    def _check_lengths(self) -> None:
        """Raise ValueError for lengths that are in other units than metres."""
        if self.square > _LARGEST_SQUARE_M:
            keys = [key for key in ("square", "marker") if getattr(self, key) is not None]
            written = _in_metres({key: (getattr(self, key),) for key in keys})
            raise ValueError(
                f"squares of {self.square:g} m are no board's; lengths are in metres: {written}"
            )
        if self.square < _SMALLEST_SQUARE_M:
            raise ValueError(
                f"squares of {self.square:g} m are too small to be seen; lengths are in metres"
            )
        away = math.hypot(*self.translation)
        if away > _FARTHEST_M:
            written = _in_metres({"translation": self.translation})
            raise ValueError(
                f"the face is {away:g} m from its robot's base; lengths are in metres: {written}"
            )

    def _check_checkerboard(self) -> None:
        if min(self.columns, self.rows) < 3:
            raise ValueError("a checkerboard needs at least 3 columns and 3 rows of squares")
        if self.columns == self.rows:
            raise ValueError(
                "a checkerboard with as many columns as rows reads the same from four sides; "
                "make columns and rows differ"
            )

    def _check_marked(self) -> None:
        if self.pattern is Pattern.CHARUCO and min(self.columns, self.rows) < 2:
            raise ValueError("a charuco board needs at least 2 columns and 2 rows of squares")
        for key in ("marker", "dictionary"):
            if getattr(self, key) is None:
                raise ValueError(f"a {self.pattern.value} face needs the key «{key}»; add it")
        if self.marker is not None and self.marker >= self.square:
            raise ValueError(
                f"the marker ({self.marker:g} m) must be smaller than the square, or the pitch "
                f"({self.square:g} m); both are in metres"
            )

    @property
    def base_from_face(self) -> Pose:
        """Pose of the face on the robot."""
        return Pose.from_quaternion(self.translation, self.quaternion)

    @property
    def corner_count(self) -> int:
        """Number of corner ids: 0 … corner_count - 1."""
        if self.pattern is Pattern.APRILGRID:
            return 4 * self.columns * self.rows
        return (self.columns - 1) * (self.rows - 1)

    @property
    def marker_count(self) -> int:
        """Number of marker ids that the face uses, from `first_marker` on."""
        if self.pattern is Pattern.CHECKERBOARD:
            return 0
        squares = self.columns * self.rows
        if self.pattern is Pattern.APRILGRID:
            return squares
        return squares // 2

    @property
    def corners(self) -> Array:
        """Corner positions in the face frame by id, (corner_count, 3), metres; read-only."""
        if self.pattern is not Pattern.APRILGRID:
            return _grid(self.columns - 1, self.rows - 1, self.square)
        # Kalibr's rows go up; the face's frame, with y down, starts at the lowest row.
        down = -1 if self.numbering is Numbering.KALIBR else 1
        return _tag_corners(self.columns, self.rows, self.square, down, self.marker or 0.0)

    @property
    def has_corner_squares(self) -> bool:
        """Whether black squares are drawn between the tags of an AprilGrid."""
        return self._as_kalibr(self.corner_squares)

    @property
    def has_turned_tags(self) -> bool:
        """Whether tags are drawn with their dictionary's top at the bottom."""
        return self._as_kalibr(self.tags_turned)

    def _as_kalibr(self, said: bool | None) -> bool:
        if self.pattern is not Pattern.APRILGRID:
            return False
        return self.numbering is Numbering.KALIBR if said is None else said

    @property
    def outline(self) -> Array:
        """The printed pattern's four outer corners in the face frame, (4, 3), metres."""
        beside = self.square
        if self.pattern is Pattern.APRILGRID:
            gap = self.square - (self.marker or 0.0)
            beside = gap if self.has_corner_squares else 0.0
        low_x, low_y, _ = self.corners.min(axis=0) - beside
        high_x, high_y, _ = self.corners.max(axis=0) + beside
        return np.array(
            [
                [low_x, low_y, 0],
                [high_x, low_y, 0],
                [high_x, high_y, 0],
                [low_x, high_y, 0],
            ]
        )

    @property
    def reads_from_both_ends(self) -> bool:
        """Whether a half turn leaves the pattern unchanged (the contract's «half turn»)."""
        return self.pattern is Pattern.CHECKERBOARD and (self.columns + self.rows) % 2 == 0

    @property
    def appearance(self) -> tuple[object, ...]:
        """What a picture can reveal about the face; faces with equal appearance look alike."""
        geometry = (self.pattern, self.columns, self.rows)
        if self.pattern is Pattern.CHECKERBOARD:
            return (*geometry, self.inverted)
        marks = (
            self.dictionary,
            self.first_marker,
            self.legacy,
            self.inverted,
            self.border_bits,
            self.numbering,
        )
        return (*geometry, *marks)


def _in_metres(lengths: Mapping[str, Sequence[float]]) -> str:
    """What to write for keys whose lengths are of another unit, which nobody can tell."""
    ways = []
    for unit, metres in _UNITS:
        said = {key: [f"{metres * one:.4g}" for one in values] for key, values in lengths.items()}
        written = [f"{key} = {_listed(values)}" for key, values in said.items()]
        ways.append(f"{' and '.join(written)} if they were {unit}")
    return f"write {', '.join(ways)}"


def _listed(values: Sequence[str]) -> str:
    return values[0] if len(values) == 1 else f"[{', '.join(values)}]"


@cache
def _grid(columns: int, rows: int, pitch: float) -> Array:
    """Corners in row-major order, (n, 3); one array shared by all callers, so do not write to
    it."""
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) * pitch
    points.flags.writeable = False
    return points


@cache
def _tag_corners(columns: int, rows: int, pitch: float, down: int, side: float) -> Array:
    """The four corners of each tag, (n, 3), shared as those of `_grid`."""
    around = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float) * side
    tags = _grid(columns, rows, pitch)[:, None] * [1, down, 1]
    points = (tags + around).reshape(-1, 3)
    points.flags.writeable = False
    return points


class Target(Struct, frozen=True, forbid_unknown_fields=True):
    """All faces of one robot."""

    name: str
    faces: tuple[Face, ...]

    def __post_init__(self) -> None:
        if not self.faces:
            raise ValueError("a target needs at least one face; add a [[faces]] table")
        ids = [face.id for face in self.faces]
        for face in ids:
            if ids.count(face) > 1:
                raise ValueError(f"two faces have the id {face}; give each its own")
        self._check_markers()

    def _check_markers(self) -> None:
        """Raise ValueError if two faces use the same marker of one dictionary."""
        ranges = [
            (f.dictionary, f.first_marker, f.first_marker + f.marker_count, f.id)
            for f in self.faces
            if f.marker_count
        ]
        for i, (dictionary, first, end, face) in enumerate(ranges):
            for other_dictionary, other_first, other_end, other in ranges[:i]:
                overlap = first < other_end and other_first < end
                if dictionary == other_dictionary and overlap and first != other_first:
                    raise ValueError(
                        f"faces {other} and {face} share markers from {max(first, other_first)} "
                        f"of {dictionary}; move first_marker"
                    )

    def face(self, face: int) -> Face:
        """A face by id; raise TargetError if there is none."""
        for candidate in self.faces:
            if candidate.id == face:
                return candidate
        raise TargetError(f"target «{self.name}» has no face {face}")

    def look_alikes(self, appearance: tuple[object, ...]) -> tuple[Face, ...]:
        """The faces that look like this one; several if no picture can tell them apart."""
        return tuple(face for face in self.faces if face.appearance == appearance)


def load_target(path: Path) -> Target:
    """Read target.toml; raise a TargetError that names file, line and key."""
    return load_toml(path, Target, "target file", TargetError)


def parse_target(text: str, *, file: str = "target.toml") -> Target:
    """Like `load_target`, from text (a recording's attachment)."""
    return parse_toml(text, Target, file, TargetError)
