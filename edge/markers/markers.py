"""Reads which marker a quadrilateral is, softly: by how well its cells match each marker's.

A detector that decides bit by bit gives up on markers of 12 to 16 pixels, half of those that a
moving target shows. Here every quadrilateral is correlated with every marker in every turn; what
is then a marker is settled by several of them agreeing on one board.
"""

from collections.abc import Iterable, Sequence
from functools import cache

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.edge.registration.dictionaries import dictionary_of, predefined_dictionary
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Face

# The cells of a quadrilateral must differ by this many grey levels (standard deviation).
LEAST_CONTRAST = 5.0
CELLS = Kernel(
    "tp_cells",
    In(np.uint8, ("h", "w")),
    In(np.float64, ("n", 8)),
    In(np.float64, ("cells", 2)),
    float,
    Out(np.float64, ("n", "cells")),
)
_AGREEMENT = Kernel(
    *("tp_marker_agreement", In(np.uint8, ("h", "w")), In(np.float64, ("n", 8))),
    *(In(np.float64, ("cells", 2)), float, In(np.float64, ("cells", "t"))),
    *(In(np.int64, ("n",)), Out(np.float64, ("n",))),
)


class Markers(Struct, frozen=True):
    """What quadrilaterals could be as markers of one face.

    `numbers`: (n,) counted from the face's first; `corners`: (n, 4, 2) pixels, clockwise from the
    marker's own top left; `scores`: (n,) correlation with the marker's cells, at most 1; `quads`:
    (n,) index of the quadrilateral. The likeliest come first.
    """

    numbers: np.ndarray
    corners: Array
    scores: Array
    quads: np.ndarray

    def __len__(self) -> int:
        return len(self.numbers)

    def first(self, count: int) -> "Markers":
        """The first so many, which are the likeliest."""
        return self._only(slice(count))

    def each_once(self) -> "Markers":
        """Each number once, where it is likeliest."""
        return self._only(np.sort(np.unique(self.numbers, return_index=True)[1]))

    def _only(self, kept: slice | np.ndarray) -> "Markers":
        return Markers(self.numbers[kept], self.corners[kept], self.scores[kept], self.quads[kept])


class MarkerReader:
    """Matches quadrilaterals with the markers of one dictionary and border."""

    def __init__(self, dictionary: str, border_bits: int, ids: Iterable[int]) -> None:
        self._row = {marker: row for row, marker in enumerate(sorted(set(ids)))}
        known = predefined_dictionary(dictionary)
        self._side = known.markerSize + 2 * border_bits
        cells = np.array(
            [_cells_of(known, marker, self._side, border_bits) for marker in self._row]
        )
        turned = np.stack([np.rot90(cells, -turn, (1, 2)) for turn in range(4)], axis=1)
        # (cells, 4 · marker + turn)
        self._templates = _normalised(turned.reshape(4 * len(cells), -1)).T.copy()
        centres = (np.arange(self._side) + 0.5) / self._side
        x, y = np.meshgrid(centres, centres)
        self._centres = np.stack([x, y], axis=-1).reshape(-1, 2)
        inside = np.abs(self._centres - 0.5).max(axis=1) < 0.5 - border_bits / self._side
        # Where the cells within the border are, (c, 2), and what each marker has there, normalised,
        # (c, markers): another one correlates by 0, give or take one over the code's side.
        self.within = self._centres[inside]
        self.codes = _normalised(cells.reshape(len(cells), -1)[:, inside]).T.copy()

    def scores(self, grey: np.ndarray, quads: Array) -> Array:
        """Correlation (n, markers, 4 turns) of quads (n, 4, 2) with each marker; 0: no contrast.

        In turn k the marker's top left is the quad's corner k.
        """
        scores = _cells(grey, quads, self._centres) @ self._templates
        return scores.reshape(len(quads), len(self._row), 4)

    def first(self, face: Face) -> int:
        """Which of this reader's markers is a face's first; its others follow."""
        return self._row[face.first_marker]

    @staticmethod
    def likeliest(scores: Array, quads: Array, least: float) -> Markers:
        """The likeliest marker for each quad by its scores (n, markers, 4), if it scores at least
        `least`."""
        own = scores.reshape(len(quads), 4 * scores.shape[1])
        best = own.argmax(axis=1)
        score = own[np.arange(len(quads)), best]
        (kept,) = (score >= least).nonzero()
        kept = kept[(-score[kept]).argsort(kind="stable")]
        numbers, turns = np.divmod(best[kept], 4)
        order = (turns[:, None] + np.arange(4)) % 4
        return Markers(numbers, quads[kept[:, None], order], score[kept], kept)

    def agreement(self, grey: np.ndarray, face: Face, quads: Array, numbers: np.ndarray) -> Array:
        """Score (n,) of quads as the upright markers `numbers` of a face."""
        which = 4 * (self.first(face) + numbers)
        return _agreement(grey, quads, self._centres, self._templates, which)

    def code_agreement(
        self, grey: np.ndarray, face: Face, quads: Array, numbers: np.ndarray
    ) -> Array:
        """The same (n,) of what is within the border, which all markers have."""
        return _agreement(grey, quads, self.within, self.codes, self.first(face) + numbers)


def readers_for(faces: Sequence[Face]) -> dict[tuple[str, int], MarkerReader]:
    """One reader for each dictionary and border among marked faces; raises TargetError."""
    ids: dict[tuple[str, int], set[int]] = {}
    for face in faces:
        dictionary_of(face)
        own = range(face.first_marker, face.first_marker + face.marker_count)
        ids.setdefault(reader_key(face), set()).update(own)
    return {key: MarkerReader(*key, own) for key, own in ids.items()}


@cache
def whole_reader(dictionary: str, border_bits: int, most: int | None = None) -> MarkerReader:
    """The reader of every marker of a dictionary, by id, or of the first so many; shared, and never
    written to."""
    count = len(predefined_dictionary(dictionary).bytesList)
    return MarkerReader(dictionary, border_bits, range(min(count, most or count)))


def reader_key(face: Face) -> tuple[str, int]:
    """The key of a face's reader in `readers_for`."""
    return face.dictionary or "", face.border_bits


def _cells(grey: np.ndarray, quads: Array, places: Array) -> Array:
    """What quads (n, 4, 2) show at places (c, 2) of the unit square, normalised, (n, c); 0: no
    contrast."""
    cells = np.empty((len(quads), len(places)))
    flat = np.ascontiguousarray(quads, float).reshape(-1, 8)
    CELLS(np.ascontiguousarray(grey), flat, places, LEAST_CONTRAST, cells)
    return cells


def _agreement(
    grey: np.ndarray, quads: Array, places: Array, templates: Array, which: np.ndarray
) -> Array:
    """Correlation (n,) of each of quads (n, 4, 2) with the template (c, t) that it should show."""
    scores = np.empty(len(quads))
    flat = np.ascontiguousarray(quads, float).reshape(-1, 8)
    _AGREEMENT(np.ascontiguousarray(grey), flat, places, LEAST_CONTRAST, templates, which, scores)
    return scores


def _cells_of(
    dictionary: cv2.aruco.Dictionary, marker: int, side: int, border_bits: int
) -> np.ndarray:
    """A marker's cells, (side, side), one pixel each."""
    return cv2.aruco.generateImageMarker(dictionary, marker, side, borderBits=border_bits)


def _normalised(cells: np.ndarray) -> Array:
    """Cells (…, c) with their mean taken away, and of length 1."""
    centred = cells - cells.mean(axis=-1, keepdims=True)
    return centred / np.maximum(np.linalg.norm(centred, axis=-1, keepdims=True), 1e-9)
