"""Finds AprilGrids: tags say which grid and where, their sides are then measured.

Corner ids are 4 · tag + corner, corners clockwise from the tag's top left, by the contract.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.messages import FaceSighting
from trigpoint.target import Face

from .detector import Appearance
from .marked_search import LEAST_AGREEMENT, MarkedSearch
from .marker_groups import MarkerGroup
from .markers import MarkerReader, predefined_dictionary
from .picture import as_grey
from .planar_fit import fit_plane, sound_corners
from .refine import refined_quads

# How far to look across a tag's side, of its border's width; and within which bounds, pixels.
_REACH_SHARE = 0.8
_REACH_PX = (1.5, 4.0)
# A tag whose side moves further than this, of its length, was no tag.
_MOST_MOVED = 0.25


class AprilGridDetector:
    """Finds every AprilGrid of the given looks; raises TargetError for an unknown dictionary."""

    def __init__(self, looks: Sequence[Appearance]) -> None:
        self._search = MarkedSearch([_Grid(look) for look in looks])

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        """The grids in a picture."""
        return self._search.search(as_grey(picture))


@dataclass(frozen=True, slots=True)
class _Grid:
    """A look; its layout is that of its corners."""

    look: Appearance

    @property
    def layout(self) -> Array:
        """The tags' corners in the face frame by number, (m, 4, 2), metres."""
        return self.look.face.corners[:, :2].reshape(-1, 4, 2)

    def locate(
        self, grey: np.ndarray, group: MarkerGroup, reader: MarkerReader
    ) -> FaceSighting | None:
        """The sighting that a group of tags is; None where the picture denies it."""
        face, size = self.look.face, (grey.shape[1], grey.shape[0])
        layout = self.layout
        fit = fit_plane(layout[group.numbers].reshape(-1, 2), group.corners.reshape(-1, 2), size)
        if fit is None:
            return None
        expected = fit.project(layout.reshape(-1, 2)).reshape(-1, 4, 2)
        inside = np.all((expected > 2) & (expected < np.array(size) - 3), axis=(1, 2))
        numbers = np.union1d(np.flatnonzero(inside), group.numbers)
        expected = expected[numbers]
        quads = refined_quads(grey, expected, _reach(face, expected))
        good = _is_tag(grey, face, quads, expected, numbers, reader)
        ids = (4 * numbers[good][:, None] + np.arange(4)).reshape(-1)
        pixels = quads[good].reshape(-1, 2)
        keep, sigma = sound_corners(face.corners[ids, :2], pixels, size)
        if not keep.any():
            return None
        return self.look.sighting(ids[keep], pixels[keep], sigma)


def _reach(face: Face, quads: Array) -> Array:
    """How far to look across the sides of each tag (n,), pixels."""
    sides = np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=-1).min(axis=1)
    cells = predefined_dictionary(face.dictionary or "").markerSize + 2 * face.border_bits
    gap = (face.square / (face.marker or face.square) - 1) / 2
    border = min(face.border_bits / cells, max(gap, 1 / cells))
    return np.clip(_REACH_SHARE * border * sides, *_REACH_PX)


def _is_tag(
    grey: np.ndarray,
    face: Face,
    quads: Array,
    expected: Array,
    numbers: np.ndarray,
    reader: MarkerReader,
) -> np.ndarray:
    """Whether each refined quadrilateral (n, 4, 2) still is its tag."""
    if len(quads) == 0:
        return np.zeros(0, dtype=bool)
    sides = np.linalg.norm(np.roll(expected, -1, axis=1) - expected, axis=-1).min(axis=1)
    moved = np.linalg.norm(quads - expected, axis=-1).max(axis=1)
    return (moved < np.maximum(_MOST_MOVED * sides, 1.5)) & (
        reader.agreement(grey, face, quads, numbers) >= LEAST_AGREEMENT
    )
