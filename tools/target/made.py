"""A target from what a person says of it: what carries the boards, how high, on which paper."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError, TargetError
from trigpoint.site.target import Face, Target
from trigpoint.tools.shapes.bodies import MARGIN_M, VANE_AZIMUTHS_DEG, Side, box_faces, vane_faces

from .check import check_target
from .fitting import Wish, fitted
from .sheets import Paper, sheets

_LARGEST_M = 5.0
_ROUNDING_M = 1e-6
_SEEN_M = 5e-4  # less is not worth a word


class Box(Struct, frozen=True):
    """A box on the robot, metres: along it, across it, and upwards."""

    length: float
    width: float
    tall: float

    @classmethod
    def parse(cls, text: str) -> "Box":
        """«0.30x0.40» or «0.30x0.40x0.25»; raises InputError."""
        try:
            lengths = [float(word) for word in text.split("x")]
        except ValueError:
            lengths = []
        if len(lengths) not in (2, 3) or not all(0 < length <= _LARGEST_M for length in lengths):
            raise InputError(
                f"--box is «{text}»; write length x width, or length x width x height, in metres: "
                "0.30x0.40"
            )
        return cls(lengths[0], lengths[1], lengths[2] if len(lengths) == 3 else min(lengths))

    def room(self, side: Side) -> tuple[float, float]:
        """Width and height that a print may have on a side, metres."""
        wide = self.width if side in (Side.FRONT, Side.BACK) else self.length
        return wide - 2 * MARGIN_M, self.tall - 2 * MARGIN_M


class Place(Struct, frozen=True):
    """Where a target is on the robot, metres: the middle of its boards above the floor, its axis
    forward and left of the base."""

    height: float
    at: tuple[float, float] = (0.0, 0.0)


class Made(Struct, frozen=True):
    """A target, and of each face by its id where it is, for people."""

    target: Target
    remarks: dict[int, str]


def boxed(
    name: str, box: Box, sides: Sequence[Side], place: Place, wish: Wish, paper: Paper
) -> Made:
    """Boards in the middle of a box's sides. Raises TargetError."""
    if place.height < box.tall / 2 - _ROUNDING_M:
        raise TargetError(
            f"a box {box.tall:g} m tall with its middle {place.height:g} m above the floor reaches "
            "into it; give a greater --height"
        )
    on_box = [box.room(side) for side in sides]
    rooms = [_least([sheet.room_m, *on_box]) for sheet in sheets(paper)]
    plain = fitted(wish, rooms, copies=len(sides))
    faces = box_faces(
        plain, sides, length=box.length, width=box.width, height=place.height, at=place.at
    )
    return _checked(name, faces, [str(side) for side in sides])


def single(name: str, side: Side, place: Place, wish: Wish, paper: Paper) -> Made:
    """One board that looks to a side of the robot. Raises TargetError."""
    plain = fitted(wish, [sheet.room_m for sheet in sheets(paper)], copies=1)
    faces = box_faces(plain, [side], length=0.0, width=0.0, height=place.height, at=place.at)
    return _checked(name, faces, [str(side)])


def vaned(name: str, place: Place, wish: Wish, paper: Paper) -> Made:
    """Six boards on three vanes. Raises TargetError."""
    rooms = [sheet.room_m for sheet in sheets(paper)]
    count = 2 * len(VANE_AZIMUTHS_DEG)
    faces = vane_faces(fitted(wish, rooms, copies=count), height=place.height, at=place.at)
    words = [
        f"vane at {VANE_AZIMUTHS_DEG[face.id // 2]:.0f}°, looks to {_azimuth_deg(face):.0f}°"
        for face in faces
    ]
    return _checked(name, faces, words)


def _least(rooms: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Width and height that fit into all rooms."""
    widths, heights = zip(*rooms, strict=True)
    return min(widths), min(heights)


def _checked(name: str, faces: tuple[Face, ...], words: Sequence[str]) -> Made:
    target = Target(name, faces)
    lowest = min(float((face.base_from_face @ face.outline)[:, 2].min()) for face in faces)
    if lowest < -_ROUNDING_M:
        raise TargetError(
            f"the boards reach {-lowest:.3f} m into the floor; give a greater --height or smaller "
            "squares"
        )
    if problems := check_target(target).problems:
        raise TargetError(problems[0])
    remarks = {
        face.id: f"{word}; {_middle_words(face)}" for face, word in zip(faces, words, strict=True)
    }
    return Made(target, remarks)


def _middle_words(face: Face) -> str:
    """«middle 0.150 m ahead, 0.400 m up»."""
    x, y, z = (face.base_from_face @ face.outline.mean(axis=0)).tolist()
    parts = [(abs(x), "ahead" if x > 0 else "behind"), (abs(y), "left" if y > 0 else "right")]
    words = [f"{length:.3f} m {way}" for length, way in parts if length > _SEEN_M]
    return f"middle {', '.join([*words, f'{z:.3f} m up'])}"


def _azimuth_deg(face: Face) -> float:
    """Where a face looks in the robot's plane: 0 ahead, 90 left."""
    x, y, _ = -face.base_from_face.rotation[:, 2]
    return math.degrees(float(np.arctan2(y, x))) % 360.0
