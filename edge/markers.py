"""Finds ArUco and AprilTag markers: one pass over a picture for each dictionary."""

from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.errors import TargetError
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face


@dataclass(frozen=True, slots=True)
class Markers:
    """`ids`: (n,); `corners`: (n, 4, 2) pixels, clockwise from each marker's own top left."""

    ids: np.ndarray
    corners: Array

    def __len__(self) -> int:
        return len(self.ids)

    def of(self, face: Face) -> "Markers":
        """Those whose ids the face uses."""
        first = face.first_marker
        own = (self.ids >= first) & (self.ids < first + face.marker_count)
        return Markers(self.ids[own], self.corners[own])


@dataclass(frozen=True, slots=True)
class MarkerKind:
    """What one pass can find."""

    dictionary: str
    border_bits: int
    inverted: bool

    @classmethod
    def of(cls, face: Face) -> "MarkerKind":
        """The kind of a face's markers."""
        return cls(face.dictionary or "", face.border_bits, face.inverted)


class MarkerFinder:
    """Finds the markers of one kind."""

    def __init__(self, kind: MarkerKind) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = kind.border_bits
        parameters.adaptiveThreshWinSizeMin = 5
        parameters.adaptiveThreshWinSizeMax = 21
        parameters.adaptiveThreshWinSizeStep = 16
        # Small markers in a far view: 12 px of perimeter is a marker of 3 px, the least that bits
        # could be read from.
        parameters.minMarkerPerimeterRate = 0.02
        self._detector = cv2.aruco.ArucoDetector(predefined_dictionary(kind.dictionary), parameters)

    def find(self, grey: np.ndarray) -> Markers:
        """The markers in a grey picture; in the negative of it where they are inverted."""
        corners, ids, _ = self._detector.detectMarkers(grey)
        if ids is None or len(ids) == 0:
            return Markers(np.zeros(0, dtype=int), np.zeros((0, 4, 2)))
        return Markers(np.asarray(ids).reshape(-1), np.asarray(corners, float).reshape(-1, 4, 2))


def predefined_dictionary(name: str) -> cv2.aruco.Dictionary:
    """One of OpenCV's marker dictionaries; raise TargetError that lists them."""
    known = [known for known in dir(cv2.aruco) if known.startswith("DICT_")]
    if name not in known:
        raise TargetError(f"the dictionary «{name}» is not known; use one of {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marked_kinds(faces: list[Face]) -> dict[MarkerKind, MarkerFinder]:
    """One finder for each kind of marker on the faces; raises TargetError."""
    for face in faces:
        size = len(predefined_dictionary(face.dictionary or "").bytesList)
        if face.first_marker + face.marker_count > size:
            raise TargetError(
                f"face {face.id} needs markers {face.first_marker} to "
                f"{face.first_marker + face.marker_count - 1}, but {face.dictionary} has {size}; "
                "use a larger dictionary"
            )
    return {kind: MarkerFinder(kind) for kind in dict.fromkeys(MarkerKind.of(f) for f in faces)}
