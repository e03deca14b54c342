"""How likely it is that a checkerboard is where a fit has it: one likelihood over its squares.

Each square is as dark or as light against its neighbours as printed, or not. A board shows nearly
all of them right, whatever else is there a third by chance. So the squares' odds add up to those of
the board against clutter. The line of squares that a larger board would have beyond each side is
weighed in the same way: it says whether the board ends there.
"""

from dataclasses import dataclass
from math import log

import numpy as np

from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face

# How often a step from square to square is there: on a board, some of which gleam or are hidden;
# and elsewhere, where it must be one way round and a quarter of the contrast.
_ON_BOARD, _BY_CHANCE = 0.88, 0.3
LEAST_STEP = 0.25
_RIGHT_NATS = log(_ON_BOARD / _BY_CHANCE)
_WRONG_NATS = log((1 - _ON_BOARD) / (1 - _BY_CHANCE))
# Odds against clutter that a sighting needs: a picture offers some ten grids, of ten thousand
# pictures none may show a board that is not there.
LEAST_NATS = log(10 * 10_000)
# How far beyond the outermost corners the outermost squares are looked at, squares: some are narrow
# or cut. How far beyond those a board that goes on is: less than the white around most boards, and
# little where the picture ends there.
OUTER_SQUARES = 0.4
END_SQUARES = (1.25, 1.1)


@dataclass(frozen=True, slots=True)
class Evidence:
    """`board`: log odds of the board against clutter, nats; `ends`: the same of its end against a
    board that goes on, top, bottom, left and right, 0 where the picture ends before that."""

    board: float
    ends: tuple[float, ...]

    @property
    def is_board(self) -> bool:
        """Whether no doubt is left that it is there and is no part of a larger one."""
        return self.board >= LEAST_NATS and min(self.ends) >= 0


def weighed(grey: np.ndarray, face: Face, fit: PlanarFit, ids: np.ndarray) -> Evidence:
    """The evidence for a board where `fit` has it. `ids`: (n,) the corners that are seen; squares
    with none of them are hidden, and say nothing."""
    rising = _rising(grey, face, fit, END_SQUARES[0])
    contrast = _contrast(rising[1:-1, 1:-1])
    known = np.zeros((face.rows + 2, face.columns + 2), dtype=bool)
    known[1:-1, 1:-1] = _beside(ids, face)
    right, total = _steps(rising, known, contrast)
    nearer = _rising(grey, face, fit, END_SQUARES[1])
    ends = (
        min(_end(side, contrast) for side in sides)
        for sides in zip(_sides(rising), _sides(nearer), strict=True)
    )
    return Evidence(right * _RIGHT_NATS + (total - right) * _WRONG_NATS, tuple(ends))


def _rising(grey: np.ndarray, face: Face, fit: PlanarFit, beyond: float) -> Array:
    """Grey values of all squares and of those that a larger board would have around them, which are
    looked at so many squares `beyond` the outermost corners, (rows + 2, columns + 2); light ones
    count as negative, and what is not in the picture is not a number."""
    x, y = np.meshgrid(np.arange(face.columns + 2), np.arange(face.rows + 2))
    across, down = (
        np.r_[
            -beyond,
            -OUTER_SQUARES,
            np.arange(count - 2) + 0.5,
            count - 2 + OUTER_SQUARES,
            count - 2 + beyond,
        ]
        for count in (face.columns, face.rows)
    )
    pixels = fit.project(face.square * np.column_stack([across[x].ravel(), down[y].ravel()]))
    inside = np.all((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1), axis=1)
    values = np.where(inside, sampled(grey, pixels), np.nan).reshape(x.shape)
    return np.where((x + y) % 2 == 0, values, -values)


def _contrast(rising: Array) -> float:
    """How much lighter the light squares are than the dark ones, most of the time; at least a grey
    level, so that nothing is a step where all is alike."""
    steps = np.concatenate(
        [-(rising[1:] + rising[:-1]).ravel(), -(rising[:, 1:] + rising[:, :-1]).ravel()]
    )
    steps = steps[~np.isnan(steps)]
    return max(1.0, float(np.median(steps))) if len(steps) else 1.0


def _beside(ids: np.ndarray, face: Face) -> np.ndarray:
    """Which squares (rows, columns) have one of the corners `ids`."""
    seen = np.zeros(face.corner_count, dtype=bool)
    seen[ids] = True
    seen = np.pad(seen.reshape(face.rows - 1, face.columns - 1), 1)
    return seen[1:, 1:] | seen[1:, :-1] | seen[:-1, 1:] | seen[:-1, :-1]


def _steps(rising: Array, known: np.ndarray, contrast: float) -> tuple[int, int]:
    """How many of the `known` squares differ from the mean of their known neighbours as they
    should, and of how many that can be said."""
    known = known & ~np.isnan(rising)
    values = np.where(known, rising, 0.0)
    total, count = np.zeros(rising.shape), np.zeros(rising.shape)
    for axis in (0, 1):
        for step in (-1, 1):
            # The margin is never known, so that nothing comes round from the other side.
            total += np.roll(values, step, axis)
            count += np.roll(known, step, axis)
    told = known & (count > 0)
    away = -(values[told] + total[told] / count[told])
    return int(np.count_nonzero(away > LEAST_STEP * contrast)), int(told.sum())


def _sides(rows: Array) -> tuple[Array, Array, Array, Array]:
    """The outermost ones of what lies in rows and columns (r, c): top, bottom, left, right."""
    return rows[0], rows[-1], rows[:, 0], rows[:, -1]


def _end(side: Array, contrast: float) -> float:
    """Log odds that a line of squares beyond a board is none of a larger one, by its steps."""
    steps = -(side[1:] + side[:-1])
    steps = steps[~np.isnan(steps)]
    goes_on = np.count_nonzero(steps > LEAST_STEP * contrast)
    return -(goes_on * _RIGHT_NATS + (len(steps) - goes_on) * _WRONG_NATS)
