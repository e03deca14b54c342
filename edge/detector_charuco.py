"""Finds ChArUco boards: markers say which board and where, its corners are then measured.

One search for quadrilaterals serves all boards of a picture. A board's plane, fitted to its
markers, predicts every corner; each is refined and must show light and dark where they should be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.messages import FaceSighting
from trigpoint.target import Face

from .detector import Appearance
from .marked_search import LEAST_AGREEMENT, MarkedSearch
from .marker_groups import MarkerGroup
from .markers import MarkerReader, predefined_dictionary
from .picture import as_grey
from .planar_fit import PlanarFit, fit_plane, sound_corners
from .refine import refined_saddles
from .saddles import sampled

# From so many corners on a plane is fitted to them; fewer hang on the plane of several markers.
LEAST_CORNERS = 4
FEW_CORNERS_SIGMA_PX = 0.4
# A corner may move this far from its predicted place, of the square's side in the picture.
REACH = 0.25
LEAST_CONTRAST = 6.0
# Where the window that meets no marker finds nothing (a steep view), one this much wider may.
_WIDER = 1.6
_MARGIN_PX = 2.0


class CharucoDetector:
    """Finds every ChArUco board of the given looks.

    Raises TargetError for an unknown dictionary.
    """

    def __init__(self, looks: Sequence[Appearance]) -> None:
        self._search = MarkedSearch([_Board.of(look) for look in looks])

    def detect(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        """The boards in a picture."""
        return self._search.search(as_grey(picture))


@dataclass(frozen=True, slots=True)
class _Board:
    """A look, and what is derived from it.

    `layout`: (m, 4, 2) corners of the markers in the face frame; `corners`: (n, 2) chessboard
    corners in it; `is_dark`: (n,) whether the square towards (-x, -y) of a corner is dark;
    `window`: the share of a square that can be used about a corner without meeting a marker's bits;
    `inset`: how far from a corner along both axes its sectors are looked at, of the square.
    """

    look: Appearance
    layout: Array
    corners: Array
    is_dark: np.ndarray
    window: float
    inset: float

    @classmethod
    def of(cls, look: Appearance) -> "_Board":
        face = look.face
        dictionary = predefined_dictionary(face.dictionary or "")
        layout = charuco_layout(face)
        corners = face.corners[:, :2]
        top_left_is_light = bool(np.any(np.all(layout.mean(axis=1) < 0, axis=-1)))
        steps = np.rint(corners / face.square).astype(int).sum(axis=1)
        marker = (face.marker or 0.0) / face.square
        margin = (1 - marker) / 2
        border = marker / (dictionary.markerSize + 2 * face.border_bits)
        return cls(
            look=look,
            layout=layout,
            corners=corners,
            is_dark=(steps % 2 == 0) != top_left_is_light,
            window=min(0.45, margin + border),
            inset=min(0.25, 0.8 * margin),
        )

    @property
    def face(self) -> Face:
        return self.look.face

    def locate(
        self, grey: np.ndarray, group: MarkerGroup, reader: MarkerReader
    ) -> FaceSighting | None:
        """The sighting that a group of markers leads to; None where the picture denies it."""
        size = (grey.shape[1], grey.shape[0])
        marks = (self.layout[group.numbers].reshape(-1, 2), group.corners.reshape(-1, 2))
        fit = fit_plane(*marks, size)
        ids, pixels = self._measured(grey, fit, self._beside(group.numbers))
        keep, _ = sound_corners(self.corners[ids], pixels, size)
        if keep.sum() >= LEAST_CORNERS:
            fit = fit_plane(self.corners[ids[keep]], pixels[keep], size)
            ids, pixels = self._measured(grey, fit, np.arange(len(self.corners)))
            keep, sigma = sound_corners(self.corners[ids], pixels, size)
            ids, pixels = ids[keep], pixels[keep]
        elif len(group.numbers) > 1:
            sigma = FEW_CORNERS_SIGMA_PX
        else:
            return None
        if len(ids) == 0 or fit is None or not self._agrees(grey, fit, group, reader):
            return None
        return self.look.sighting(ids, pixels, sigma)

    def _beside(self, numbers: np.ndarray) -> np.ndarray:
        """Ids of the corners of the squares that hold the markers."""
        offset = np.abs(self.corners[:, None] - self.layout[numbers].mean(axis=1)[None])
        return np.flatnonzero(np.any(np.all(offset < 0.75 * self.face.square, axis=-1), axis=1))

    def _measured(
        self, grey: np.ndarray, fit: PlanarFit | None, ids: np.ndarray
    ) -> tuple[np.ndarray, Array]:
        """Those of the corners `ids` that the picture shows, and where; (k,), (k, 2)."""
        if fit is None:
            return ids[:0], np.zeros((0, 2))
        predicted = fit.project(self.corners[ids])
        across = fit.project(self.corners[ids] + [self.face.square, 0.0]) - predicted
        down = fit.project(self.corners[ids] + [0.0, self.face.square]) - predicted
        spacing = np.minimum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1))
        limit = np.array([grey.shape[1], grey.shape[0]]) - 1 - _MARGIN_PX
        inside = np.all((predicted > _MARGIN_PX) & (predicted < limit), axis=-1) & (spacing > 3)
        ids, predicted, spacing = ids[inside], predicted[inside], spacing[inside]
        pixels, shown = predicted.copy(), np.zeros(len(ids), dtype=bool)
        for share in (self.window, _WIDER * self.window):
            left = np.flatnonzero(~shown)
            if len(left) == 0:
                break
            moved = refined_saddles(grey, predicted[left], spacing[left], share=share)
            near = np.linalg.norm(moved - predicted[left], axis=-1) < REACH * spacing[left]
            diagonals = (across[inside][left], down[inside][left])
            right = near & self._shows_sectors(grey, moved, *diagonals, self.is_dark[ids[left]])
            pixels[left[right]], shown[left[right]] = moved[right], True
        return ids[shown], pixels[shown]

    def _shows_sectors(
        self, grey: np.ndarray, pixels: Array, across: Array, down: Array, is_dark: np.ndarray
    ) -> np.ndarray:
        """Whether the four sectors of each corner (n, 2) are dark and light as on the board."""
        diagonal, other = self.inset * (across + down), self.inset * (across - down)
        around = np.stack([-diagonal, diagonal, -other, other], axis=1)
        values = sampled(grey, pixels[:, None] + around)
        first, second = values[:, :2], values[:, 2:]
        dark = np.where(is_dark[:, None], first, second)
        light = np.where(is_dark[:, None], second, first)
        enough = light.mean(axis=1) - dark.mean(axis=1) > LEAST_CONTRAST
        return enough & (light.min(axis=1) > dark.max(axis=1))

    def _agrees(
        self, grey: np.ndarray, fit: PlanarFit, group: MarkerGroup, reader: MarkerReader
    ) -> bool:
        """Whether the markers, where the corners put them, are the board's."""
        quads = fit.project(self.layout[group.numbers].reshape(-1, 2)).reshape(-1, 4, 2)
        scores = reader.agreement(grey, self.face, quads, group.numbers)
        return bool(scores.mean() >= LEAST_AGREEMENT)


def charuco_layout(face: Face) -> Array:
    """The markers' corners in the face frame by number, (m, 4, 2), metres."""
    board = cv2.aruco.CharucoBoard(
        (face.columns, face.rows),
        face.square,
        face.marker or 0.0,
        predefined_dictionary(face.dictionary or ""),
    )
    board.setLegacyPattern(face.legacy)
    corners = np.array(board.getObjPoints(), dtype=float).reshape(-1, 4, 3)
    # OpenCV's origin is the board's outer corner, the contract's is corner 0.
    return corners[..., :2] - face.square
