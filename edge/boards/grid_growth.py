"""Makes a grid of corners whole: drops the wild ones, and looks where the next ones should be.

Every corner is judged by those about it, and every free place is predicted from them, so that no
lens and no paper is too bent: over two squares each is nearly a parallelogram.
"""

import numpy as np

from trigpoint.geometry.rotation import Array

from .grid import Grid
from .saddles import Curvature, Saddles, examine
from .tuning import TUNING


def cleaned(grid: Grid) -> Grid:
    """The grid without corners that do not lie where their neighbours have them; those that nothing
    can be said about stay."""
    for _ in range(TUNING.most_drops):
        if len(grid) == 0:
            break
        lattice, low = _lattice(grid)
        x, y = (grid.places - low).T
        off = np.linalg.norm(_predicted(lattice)[y, x] - grid.pixels, axis=-1)
        # Two corners in one place are a thousandth of a pixel apart.
        off = np.nan_to_num(off / np.maximum(_steps(lattice)[y, x], 1e-3), nan=0.0)
        worst = float(off.max())
        if worst <= TUNING.most_off:
            break
        grid = grid.only(off < max(TUNING.most_off, 0.7 * worst))
    return grid


def grown(grid: Grid, curvature: Curvature, largest: tuple[int, int]) -> Grid:
    """The grid with every corner that its own predict and the picture shows.

    Stops at the pattern's edge, where no X corner is; `largest`: the longer and the shorter extent
    of any pattern that is looked for.
    """
    for _ in range(TUNING.most_rounds):
        if len(grid) < TUNING.least_seed or max(grid.extent) > max(largest) + 1:
            break
        added = _found_beside(grid, curvature)
        if added is None:
            break
        added = cleaned(added)
        if len(added) <= len(grid):  # what was found is not the board's, and would be found again
            break
        grid = added
    return grid


def _lattice(grid: Grid) -> tuple[Array, np.ndarray]:
    """The grid's pixels by place (h, w, 2), not a number where it has none, with two free places on
    every side; and the place of the first."""
    low = grid.places.min(axis=0) - 2
    width, height = grid.places.max(axis=0) + 3 - low
    lattice = np.full((height, width, 2), np.nan)
    x, y = (grid.places - low).T
    lattice[y, x] = grid.pixels
    return lattice, low


def _shifted(lattice: Array, dx: int, dy: int) -> Array:
    """What lies (dx, dy) on from each place; not a number beyond the lattice."""
    height, width = lattice.shape[:2]
    moved = np.full_like(lattice, np.nan)
    to_y, from_y = slice(max(-dy, 0), height - max(dy, 0)), slice(max(dy, 0), height + min(dy, 0))
    to_x, from_x = slice(max(-dx, 0), width - max(dx, 0)), slice(max(dx, 0), width + min(dx, 0))
    moved[to_y, to_x] = lattice[from_y, from_x]
    return moved


_SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))


def _predicted(lattice: Array) -> Array:
    """Where each place's neighbours have it, (h, w, 2): the median of what every two beside it on a
    line, and every three of a square, say."""
    near = {side: _shifted(lattice, *side) for side in _SIDES}
    said = []
    for dx, dy in _SIDES:
        said.append(2 * near[dx, dy] - _shifted(lattice, 2 * dx, 2 * dy))
        beside = near[-dy, dx]
        said.append(near[dx, dy] + beside - _shifted(lattice, dx - dy, dy + dx))
        # Between two is twice as sure as beyond two, and they are met from both sides.
        said.append(0.5 * (near[dx, dy] + near[-dx, -dy]))
    # What is no number comes last.
    said = np.sort(said, axis=0)
    middle = np.maximum(np.count_nonzero(~np.isnan(said), axis=0, keepdims=True) - 1, 0) // 2
    return np.take_along_axis(said, middle, axis=0)[0]


def _steps(lattice: Array) -> Array:
    """How far it is from each place to the next ones, (h, w), the shorter of both ways."""
    across, down = (np.linalg.norm(_slope(lattice, *side), axis=-1) for side in _SIDES[:2])
    return np.fmin(across, down)


def _slope(lattice: Array, dx: int, dy: int) -> Array:
    """The step (h, w, 2) at each place along (dx, dy), by what lies before and behind it."""
    ahead, behind = _shifted(lattice, dx, dy) - lattice, lattice - _shifted(lattice, -dx, -dy)
    known = np.where(np.isnan(ahead), behind, ahead)
    return 0.5 * (known + np.where(np.isnan(behind), ahead, behind))


def _found_beside(grid: Grid, curvature: Curvature) -> Grid | None:
    """The grid with the corners found in free places next to it, None where there is none."""
    lattice, low = _lattice(grid)
    there = _predicted(lattice)
    filled = np.where(np.isnan(lattice), there, lattice)
    step = _steps(filled)
    is_free = np.isnan(lattice[..., 0]) & _inside(there, curvature.smooth.shape) & (step > 0)
    rows, columns = np.nonzero(is_free)
    if len(rows) == 0:
        return None
    places = np.stack([columns, rows], axis=-1) + low
    predicted, spacing = there[rows, columns], step[rows, columns]
    diagonal = (_slope(filled, 1, 0) + _slope(filled, 0, 1))[rows, columns]
    found, which = _nearest_to(examine(curvature, predicted, tolerance=TUNING.tolerance), predicted)
    ok = np.linalg.norm(found.pixels - predicted[which], axis=-1) < TUNING.most_off * spacing[which]
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
