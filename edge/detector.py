"""From a picture to the faces in it. `DETECTORS` says which FaceFinder finds which pattern."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

import numpy as np

from trigpoint.messages import FaceSighting
from trigpoint.target import Face, Pattern, Target

from .picture import as_grey

if TYPE_CHECKING:
    from .measurement import Located
    from .planar_fit import PlanarFit
    from .region import Region

DETECTORS: dict[Pattern, str] = {
    Pattern.CHECKERBOARD: "detector_checkerboard:CheckerboardDetector",
    Pattern.CHARUCO: "detector_charuco:CharucoDetector",
    Pattern.APRILGRID: "detector_aprilgrid:AprilGridDetector",
}


class TargetDetector(Protocol):
    """Finds faces. Keeps no state between pictures; one instance a thread."""

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        """The faces in a picture, (height, width) grey or (height, width, 3) BGR, uint8.

        Raises InputError where the array is no such picture.
        """
        ...


class FaceFinder(Protocol):
    """Finds the faces of one pattern in grey pictures, (height, width) uint8."""

    def locate(
        self, grey: np.ndarray, is_over: "IsOver", within: "Region | None" = None
    ) -> "list[Located]":
        """The faces in a picture, or those that show plainly in a part of it, at a third of the
        time; those found so far where `is_over` becomes true."""
        ...

    def follow(
        self,
        grey: np.ndarray,
        last: "Located",
        fit: "PlanarFit",
        *,
        reach_px: float,
        is_over: "IsOver" = ...,
    ) -> "Located | None":
        """A face that was found before and now lies where `fit` has it, to a pixel, or up to
        `reach_px` beside that; None where not, or where `is_over` becomes true before."""
        ...


IsOver = Callable[[], bool]
"""Whether the time for a picture is used up."""


def never() -> bool:
    """Of a search that may take its time; its work is bounded by counts."""
    return False


@dataclass(frozen=True, slots=True)
class Appearance:
    """One look that a face can have, and whose it is.

    `target`: the target's name, "" where several robots carry the look; `face_id`: the face's id,
    -1 where faces of different ids look alike. `face` is one of those that look so.
    """

    face: Face
    target: str
    face_id: int

    @property
    def is_unique(self) -> bool:
        """Whether only one face of one robot looks so, which a picture shows once at most."""
        return self.target != "" and self.face_id >= 0

    def sighting(self, corners: np.ndarray, pixels: np.ndarray, sigma: float) -> FaceSighting:
        """A sighting of this look; `corners`: (n,) ids; `pixels`: (n, 2)."""
        return FaceSighting(
            self.target, self.face_id, corners.astype(np.uint16), pixels.astype(np.float32), sigma
        )


def appearances(targets: Sequence[Target]) -> tuple[Appearance, ...]:
    """Every look among the robots' targets, one target a robot, each once."""
    owners: dict[tuple[object, ...], list[tuple[int, Target, Face]]] = {}
    for robot, target in enumerate(targets):
        for face in target.faces:
            owners.setdefault(face.appearance, []).append((robot, target, face))
    return tuple(_appearance(same) for same in owners.values())


def detector_for(targets: Sequence[Target]) -> TargetDetector:
    """One detector for all faces of all robots' targets, one target a robot."""
    return _AllDetectors(finders_for(targets))


def finders_for(targets: Sequence[Target]) -> "dict[Pattern, FaceFinder]":
    """A finder for every pattern that the robots' targets have."""
    looks = appearances(targets)
    return {
        pattern: _open(path)([look for look in looks if look.face.pattern is pattern])
        for pattern, path in DETECTORS.items()
        if any(look.face.pattern is pattern for look in looks)
    }


class _AllDetectors:
    """The finders of every pattern that a site has, one after the other."""

    def __init__(self, finders: "dict[Pattern, FaceFinder]") -> None:
        self._finders = finders

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        grey = as_grey(picture)
        finders = self._finders.values()
        return tuple(face.sighting for finder in finders for face in finder.locate(grey, never))


def _appearance(same: list[tuple[int, Target, Face]]) -> Appearance:
    robots = {robot for robot, _, _ in same}
    ids = {face.id for _, _, face in same}
    alone = len(same) == len(robots)
    _, target, face = same[0]
    return Appearance(
        face=face,
        target=target.name if len(robots) == 1 else "",
        face_id=face.id if len(ids) == 1 and alone else -1,
    )


def _open(path: str) -> Callable[[Sequence[Appearance]], FaceFinder]:
    module, _, name = path.partition(":")
    return getattr(import_module(f".{module}", __package__), name)
