"""How likely it is that a checkerboard is where a fit has it: one likelihood over its squares.

Each square is as dark or as light against its neighbours as printed, or not. A board shows nearly
all of them right, whatever else is there a third by chance. So the squares' odds add up to those of
the board against clutter. The line of squares that a larger board would have beyond each side is
weighed in the same way: it says whether the board ends there. And a board's corners lie as evenly
as it is printed, while those of clutter, as where bars cross, may do so or not.
"""

from dataclasses import dataclass
from math import log

import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.image.sampling import sampled
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.geometry.rotation import Array
from trigpoint.target import Face

from .tuning import TUNING


@dataclass(frozen=True, slots=True)
class Evidence:
    """`board`: log odds of the board against clutter, nats; `ends`: the same of its end against a
    board that goes on, top, bottom, left and right, 0 where the picture ends before that."""

    board: float
    ends: tuple[float, ...]

    @property
    def is_board(self) -> bool:
        """Whether no doubt is left that it is there and is no part of a larger one."""
        return self.board >= TUNING.least_nats and min(self.ends) >= 0


def weighed(
    grey: np.ndarray, face: Face, fit: PlanarFit, ids: np.ndarray, pixels: Array
) -> Evidence:
    """The evidence for a board where `fit` has it. `ids`: (n,) the corners that are seen, at
    `pixels` (n, 2); squares with none of them are hidden, and say nothing."""
    rising, sides = _rising(grey, face, fit)
    contrast = _contrast(rising)
    right, total = _steps(rising, _beside(ids, face), contrast)
    ends = tuple(min(_end(line, contrast) for line in lines) for lines in sides)
    squares = right * TUNING.right_nats + (total - right) * TUNING.wrong_nats
    return Evidence(squares + _evenness(face, fit, ids, pixels), ends)


def _rising(grey: np.ndarray, face: Face, fit: PlanarFit) -> tuple[Array, list[Array]]:
    """Grey values of all squares (rows, columns), and of those that a larger board would have on
    each side, at each of its `end_squares`, (2, n) a side: top, bottom, left, right. Light
    ones count as negative, and what is not in the picture is not a number."""
    x, y = np.arange(face.columns), np.arange(face.rows)
    across, down = x - 0.5, y - 0.5
    across[[0, -1]] = -TUNING.outer_squares, face.columns - 2 + TUNING.outer_squares
    down[[0, -1]] = -TUNING.outer_squares, face.rows - 2 + TUNING.outer_squares
    parts = [_lattice(across, down, x, y)]
    ends = np.array(TUNING.end_squares)
    for far, place in ((-ends, -1), (face.rows - 2 + ends, face.rows)):
        parts.append(_lattice(across, far, x, np.full(len(ends), place)))
    for far, place in ((-ends, -1), (face.columns - 2 + ends, face.columns)):
        parts.append(_lattice(down, far, y, np.full(len(ends), place))[:, [1, 0, 2]])
    places = np.concatenate(parts)
    pixels = fit.project(face.square * places[:, :2])
    inside = np.all((pixels >= 0) & (pixels <= np.array(grey.shape[::-1]) - 1), axis=1)
    values = places[:, 2] * np.where(inside, sampled(grey, pixels), np.nan)
    board, *sides = np.split(values, np.cumsum([len(part) for part in parts])[:-1])
    shape = (face.rows, face.columns)
    return board.reshape(shape), [side.reshape(len(ends), -1) for side in sides]


def _lattice(first: Array, second: Array, x: np.ndarray, y: np.ndarray) -> Array:
    """Places (n · m, 3) of a row of `first` (n,) for each `second` (m,), in squares from corner 0,
    and the sign of the squares there, which are number `x` and `y`."""
    sign = np.where((x + y[:, None]) % 2 == 0, 1.0, -1.0)
    return np.column_stack(
        [np.tile(first, len(second)), np.repeat(second, len(first)), sign.ravel()]
    )


def _contrast(rising: Array) -> float:
    """How much lighter the light squares are than the dark ones, most of the time; at least a grey
    level, so that nothing is a step where all is alike."""
    steps = np.concatenate(
        [-(rising[1:] + rising[:-1]).ravel(), -(rising[:, 1:] + rising[:, :-1]).ravel()]
    )
    steps = steps[~np.isnan(steps)]
    return max(1.0, median(steps)) if len(steps) else 1.0


def _evenness(face: Face, fit: PlanarFit, ids: np.ndarray, pixels: Array) -> float:
    """Log odds of a board by how evenly its corners lie, nats: of each against the next ones, which
    a lens or a curl that the fit does not have moves alike. 0 where none lie side by side."""
    there = np.full((face.corner_count, 2), np.nan)
    there[ids] = pixels
    expected = fit.project(face.corners[:, :2])
    shape = (face.rows - 1, face.columns - 1, 2)
    off, expected = (there - expected).reshape(shape), expected.reshape(shape)
    uneven, steps = (
        np.concatenate([np.diff(values, axis=axis).reshape(-1, 2) for axis in (0, 1)])
        for values in (off, expected)
    )
    known = ~np.isnan(uneven[:, 0])
    if not known.any():
        return 0.0
    spacing = median(np.linalg.norm(steps[known], axis=1))
    # Of a coordinate of one corner: each difference has two.
    variance = float(np.mean(uneven[known] ** 2)) / 2 / spacing**2
    even, chance = TUNING.even_share**2 + (TUNING.grain_px / spacing) ** 2, TUNING.uneven_share**2
    told = len(ids) * (log(chance / even) - variance * (1 / even - 1 / chance))
    by_chance = TUNING.even_by_chance
    return -float(np.logaddexp(log(by_chance), log(1 - by_chance) - told))


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
    for to, beside in (
        (np.s_[1:], np.s_[:-1]),
        (np.s_[:-1], np.s_[1:]),
        (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[:, :-1], np.s_[:, 1:]),
    ):
        total[to] += values[beside]
        count[to] += known[beside]
    told = known & (count > 0)
    away = -(values[told] + total[told] / count[told])
    return int(np.count_nonzero(away > TUNING.least_step * contrast)), int(told.sum())


def _end(side: Array, contrast: float) -> float:
    """Log odds that a line of squares beyond a board is none of a larger one, by its steps."""
    steps = -(side[1:] + side[:-1])
    steps = steps[~np.isnan(steps)]
    goes_on = np.count_nonzero(steps > TUNING.least_step * contrast)
    return -(goes_on * TUNING.right_nats + (len(steps) - goes_on) * TUNING.wrong_nats)
