"""Finds the faces in a picture. `DETECTORS`: the FaceFinder of each pattern, made of all looks of
the site."""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Protocol

import numpy as np

from trigpoint.contract.messages import FaceSighting
from trigpoint.site.target import Pattern, Target

from .image.picture import as_grey
from .image.time_limit import never
from .registration.appearance import Appearance, appearances
from .registration.finder import FaceFinder

DETECTORS: dict[Pattern, str] = {
    Pattern.CHECKERBOARD: "boards.detector_checkerboard:CheckerboardDetector",
    Pattern.CHARUCO: "markers.detector_charuco:CharucoDetector",
    Pattern.APRILGRID: "markers.detector_aprilgrid:AprilGridDetector",
}


class TargetDetector(Protocol):
    """Finds faces. Keeps no state between pictures; one instance per thread."""

    @property
    def misdescribed(self) -> tuple[str, ...]:
        """Boards that the target file describes wrongly by what was seen so far, each once, with
        what to write instead."""
        ...

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        """The faces in a picture, (height, width) grey or (height, width, 3) BGR, uint8.

        Raises InputError if the array is not such a picture.
        """
        ...


def detector_for(targets: Sequence[Target]) -> TargetDetector:
    """One detector for all faces of all robots' targets, one target per robot."""
    return _AllDetectors(finders_for(targets))


def finders_for(targets: Sequence[Target]) -> dict[Pattern, FaceFinder]:
    """A finder for each pattern on the robots' targets."""
    looks = appearances(targets)
    return {
        pattern: _open(path)(looks)
        for pattern, path in DETECTORS.items()
        if any(look.face.pattern is pattern for look in looks)
    }


def misdescribed(finders: dict[Pattern, FaceFinder]) -> tuple[str, ...]:
    """Boards seen by the finders so far that the target file describes wrongly."""
    return tuple(line for finder in finders.values() for line in finder.misdescribed)


class _AllDetectors:
    """Runs the finders of all of a site's patterns, one after the other."""

    def __init__(self, finders: dict[Pattern, FaceFinder]) -> None:
        self._finders = finders

    @property
    def misdescribed(self) -> tuple[str, ...]:
        return misdescribed(self._finders)

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        grey = as_grey(picture)
        finders = self._finders.values()
        return tuple(face.sighting for finder in finders for face in finder.locate(grey, never))


def _open(path: str) -> Callable[[Sequence[Appearance]], FaceFinder]:
    module, _, name = path.partition(":")
    return getattr(import_module(f".{module}", __package__), name)
