"""Where a ChArUco board ends, against where its file says.

A legacy board with an odd number of columns is, but for its last column, the board that a file
without `legacy` describes, less that one's first column: its markers contradict nothing while the
last column is out of the picture.
"""

import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.registration.measurement import Measured
from trigpoint.edge.registration.printed_pattern import squares_are_light
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face

from .markers import LEAST_CONTRAST

# Where a line of squares is looked at: how deep from its edge, and between its squares' sides; in
# squares, as the distance of what is looked at from the nearest corner.
_DEEP, _BETWEEN, _REACH = (0.1, 0.2), (0.3, 0.5, 0.7), 1.6
# Dark squares of one line: the file's own may be lost to a glare one at a time.
_LEAST_GONE = 2
# Each of the four squares that meet at a corner is looked at between that and its marker.
_BESIDE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def ends_early(grey: np.ndarray, face: Face, found: Measured) -> bool:
    """Whether a board ends one line of squares before the file says: all along an outermost line
    its dark squares are light from the inner edge on, up to which the next line is as printed. What
    hides a line does not end so exactly at its edge."""
    middle = _middle(grey, face, found)
    return middle is not None and any(
        _is_missing(grey, face, found, middle, is_column=is_column, is_last=is_last)
        for is_column in (True, False)
        for is_last in (True, False)
    )


def _middle(grey: np.ndarray, face: Face, found: Measured) -> float | None:
    """The grey value between what is dark and what is light around the corners; None where that
    is too alike."""
    corners = found.corners
    half = (face.square - (face.marker or 0.0)) / 4
    spots = face.corners[corners, None, :2] + half * _BESIDE
    pixels = found.fit.project(spots.reshape(-1, 2)).reshape(spots.shape)
    values = np.sort(sampled(grey, pixels), axis=1)
    dark, light = median(values[:, 1]), median(values[:, 2])
    return (dark + light) / 2 if light - dark > LEAST_CONTRAST else None


def _is_missing(
    grey: np.ndarray,
    face: Face,
    found: Measured,
    middle: float,
    *,
    is_column: bool,
    is_last: bool,
) -> bool:
    along, count = (face.rows, face.columns) if is_column else (face.columns, face.rows)
    outer, inner = (count - 1, count - 2) if is_last else (0, 1)
    edge = float(outer if is_last else inner)  # between the two lines, in squares
    away = 1.0 if is_last else -1.0
    steps = np.arange(along)
    reach = face.corners[found.corners, :2] / face.square + 1  # in squares from the top left

    def seen(line: int, way: float, *, dark: bool) -> Array:
        """The grey values (k, d · 3) of a line's dark, or light, squares on one side of the edge,
        where these lie in the picture and near found corners."""
        ends = (np.full(along, line), steps) if is_column else (steps, np.full(along, line))
        mine = steps[squares_are_light(face, *ends) != dark]
        across, down = np.meshgrid(edge + way * np.array(_DEEP), _BETWEEN)
        across = np.broadcast_to(across, (len(mine), *across.shape)).reshape(len(mine), -1)
        beside = (mine[:, None, None] + down).reshape(len(mine), -1)
        spots = np.stack([across, beside] if is_column else [beside, across], axis=-1)
        pixels = found.fit.project((spots.reshape(-1, 2) - 1) * face.square)
        pixels = pixels.reshape(*spots.shape)
        is_in = np.all((pixels > 1) & (pixels < np.array(grey.shape[::-1]) - 2), axis=(1, 2))
        apart = np.abs(spots.mean(axis=1)[:, None] - reach[None]).max(axis=-1).min(axis=1)
        chosen = pixels[is_in & (apart < _REACH)]
        return sampled(grey, chosen)

    gone = seen(outer, away, dark=True)
    printed = seen(inner, -away, dark=True)
    return (
        len(gone) >= _LEAST_GONE
        and len(printed) > 0
        and bool(np.all(gone > middle))
        and bool(np.all(printed < middle))
    )
