"""Makes a grid of corners whole: drops the wild ones, and looks where the next ones should be."""

from collections.abc import Callable

import numpy as np

from trigpoint.edge.image.median import median
from trigpoint.edge.registration.planar_fit import (
    LEAST_WILD_PX,
    WILD_SIGMAS,
    PlanarFit,
    fit_plane,
    settled_fit,
    sound_corners,
)
from trigpoint.geometry.rotation import Array

from .grid import Grid
from .saddles import Curvature, Saddles, examine

LEAST_SEED = 9
MOST_SEEDS = 6
# How far a seed's surroundings reach, steps; how far off their plane a corner may be, of a step.
SEED_REACH = 2
FLAT = 0.15
MOST_ROUNDS = 6
# How often the wildest corners of a grid are dropped before its lens is looked at.
MOST_DROPS = 3
# Corners that are all so near their plane need no lens, pixels.
ENOUGH_PX = 0.7
# A predicted corner may be this much weaker than one that nothing predicted,
TOLERANCE = 1.7
# and this far from its place, of the grid's spacing there.
REACH = 0.3


def cleaned(grid: Grid, size: tuple[int, int], may_bend: Callable[[], bool] = lambda: True) -> Grid:
    """The grid without corners that lie off its plane; `size`: width and height of the picture.

    `may_bend`: asked where only a lens could explain the grid, which takes long; where it is
    false no corner is left.
    """
    keep = _near_plane(grid, size)
    if keep is None and may_bend():
        keep, _ = sound_corners(grid.places.astype(float), grid.pixels, size)
    return grid.only(np.zeros(len(grid), dtype=bool) if keep is None else keep)


def _near_plane(grid: Grid, size: tuple[int, int]) -> np.ndarray | None:
    """Which corners (n,) are on a plane without a lens, where that is plain: after the wildest are
    dropped all are near it. None where it is not, since a lens or chance made the grid."""
    places, keep = grid.places.astype(float), np.ones(len(grid), dtype=bool)
    for _ in range(MOST_DROPS):
        fit = fit_plane(places[keep], grid.pixels[keep], size, has_lens=False)
        if fit is None:
            return None
        distances = fit.residuals(places, grid.pixels)
        worst = float(distances[keep].max())
        if worst <= LEAST_WILD_PX:
            return keep
        limit = max(LEAST_WILD_PX, WILD_SIGMAS * median(distances[keep]))
        if worst <= limit:
            return None
        keep &= distances < max(limit, 0.7 * worst)
    return None


def largest_flat(grid: Grid, size: tuple[int, int]) -> np.ndarray:
    """Which corners (n,) of a grid lie on the plane that most of them share; for a grid that runs
    over two boards. Planes are laid through the surroundings of some corners."""
    best = np.zeros(len(grid), dtype=bool)
    across, down = (np.abs(line[:, None] - line) for line in grid.places.T)
    apart = np.maximum(across, down)
    crowded = np.argsort(-(apart <= 1).sum(axis=1), kind="stable")
    for seed in crowded[:: max(1, len(grid) // MOST_SEEDS)][:MOST_SEEDS]:
        keep = apart[seed] <= SEED_REACH
        for _ in range(2):
            if keep.sum() < LEAST_SEED:
                break
            places = grid.places[keep].astype(float)
            fit = fit_plane(places, grid.pixels[keep], size, has_lens=False)
            if fit is None:
                break
            spacing = np.median(np.linalg.norm(np.diff(grid.pixels[keep], axis=0), axis=-1))
            keep = fit.residuals(grid.places.astype(float), grid.pixels) < FLAT * spacing
            if keep.sum() > best.sum():
                best = keep
        if best.all():
            break
    return best


def grown(
    grid: Grid,
    curvature: Curvature,
    largest: tuple[int, int],
    may_bend: Callable[[], bool] = lambda: True,
) -> Grid:
    """The grid with every corner that its plane predicts and the picture shows.

    Stops at the pattern's edge, where no X corner is; `largest`: the longer and the shorter extent
    of any pattern that is looked for; `may_bend`: as of `cleaned`.
    """
    height, width = curvature.smooth.shape
    for _ in range(MOST_ROUNDS):
        if len(grid) < LEAST_SEED or max(grid.extent) > max(largest) + 1:
            break
        places = grid.places.astype(float)
        fit = settled_fit(places, grid.pixels, (width, height), ENOUGH_PX)
        added = _found_beside(grid, fit, curvature) if fit else None
        if added is None:
            break
        added = cleaned(added, (width, height), may_bend)
        if len(added) <= len(grid):  # what was found is not the board's, and would be found again
            break
        grid = added
    return grid


def _found_beside(grid: Grid, fit: PlanarFit, curvature: Curvature) -> Grid | None:
    """The grid with the corners found in free places next to it, None where there is none."""
    places = _free_places(grid.places)
    predicted = fit.project(places.astype(float))
    across = fit.project(places + np.array([1.0, 0.0])) - predicted
    down = fit.project(places + np.array([0.0, 1.0])) - predicted
    spacing = np.minimum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1))
    inside = _inside(predicted, curvature.smooth.shape)
    places, predicted, spacing = places[inside], predicted[inside], spacing[inside]
    diagonal = (across + down)[inside]
    if len(places) == 0:
        return None
    found, which = _nearest_to(examine(curvature, predicted, tolerance=TOLERANCE), predicted)
    ok = np.linalg.norm(found.pixels - predicted[which], axis=-1) < REACH * spacing[which]
    dark = _is_dark_towards(found.directions, -diagonal[which])
    ok &= dark == _expected_dark(grid, places[which])
    if not ok.any():
        return None
    return Grid(
        np.concatenate([grid.places, places[which][ok]]),
        np.concatenate([grid.pixels, found.pixels[ok]]),
        np.concatenate([grid.is_dark, dark[ok]]),
    )


def _nearest_to(found: Saddles, predicted: Array) -> tuple[Saddles, np.ndarray]:
    """The found corners, each once, and the index of the prediction that each is nearest to."""
    distance = np.linalg.norm(found.pixels[:, None] - predicted[None], axis=-1)
    which = np.argmin(distance, axis=1) if len(found) else np.zeros(0, dtype=int)
    _, first = np.unique(which, return_index=True)
    once = Saddles(found.pixels[first], found.directions[first], found.amplitude[first])
    return once, which[first]


def _free_places(places: np.ndarray) -> np.ndarray:
    """Places (m, 2) that are free and have two corners among the eight around them."""
    low = places.min(axis=0) - 1
    width, height = places.max(axis=0) + 2 - low
    taken = np.zeros((height + 2, width + 2), dtype=int)
    x, y = (places - low + 1).T
    taken[y, x] = 1
    around = sum(
        taken[1 + dy : height + 1 + dy, 1 + dx : width + 1 + dx]
        for dx in (-1, 0, 1)
        for dy in (-1, 0, 1)
    )
    rows, columns = np.nonzero((taken[1:-1, 1:-1] == 0) & (around >= 2))
    return np.stack([columns, rows], axis=-1) + low


def _inside(pixels: Array, shape: tuple[int, ...]) -> np.ndarray:
    margin = 3.0
    limit = np.array([shape[1], shape[0]]) - 1 - margin
    return np.all((pixels > margin) & (pixels < limit), axis=-1)


def _is_dark_towards(directions: Array, towards: Array) -> np.ndarray:
    """Whether the sector of each corner (n, 4 angles) that holds `towards` (n, 2) is dark."""
    angle = np.arctan2(towards[:, 1], towards[:, 0])
    past = (angle[:, None] - directions) % (2 * np.pi)
    return np.argmin(past, axis=-1) % 2 == 1


def _expected_dark(grid: Grid, places: np.ndarray) -> np.ndarray:
    """Whether the square towards (-x, -y) of each place must be dark, by the grid's majority."""
    parity = grid.places.sum(axis=1) % 2
    votes = np.where(grid.is_dark == (parity == 0), 1, -1).sum()
    return (places.sum(axis=1) % 2 == 0) == (votes > 0)
