"""Joins X corners into the grids that they form, each with whole-number coordinates.

Two corners are neighbours where the edges that leave them meet: each lies in the direction of one
of the other's edges, with light and dark on the same sides, and is the nearest such. Links that
both ends choose make a graph; walking it gives every corner its place. Bounded work, no search
that fails slowly.
"""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np

from trigpoint.geometry.rotation import Array

from .saddles import Saddles
from .tuning import TUNING

# Steps of the four directions of a corner: x, y, -x, -y.
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


@dataclass(frozen=True, slots=True)
class Grid:
    """A connected grid of corners.

    `places`: (n, 2) whole x and y, x × y pointing into the picture (never mirrored); `pixels`:
    (n, 2); `is_dark`: (n,) whether the square towards (-x, -y) is dark.
    """

    places: np.ndarray
    pixels: Array
    is_dark: np.ndarray

    def __len__(self) -> int:
        return len(self.places)

    def only(self, keep: np.ndarray) -> "Grid":
        """The grid of the corners where `keep` (n,) is true."""
        return Grid(self.places[keep], self.pixels[keep], self.is_dark[keep])

    @property
    def extent(self) -> tuple[int, int]:
        """How many corners wide and high the grid is."""
        if len(self) == 0:
            return 0, 0
        width, height = self.places.max(axis=0) - self.places.min(axis=0) + 1
        return int(width), int(height)


def find_grids(saddles: Saddles) -> list[Grid]:
    """All grids of enough corners, largest first."""
    if len(saddles) < TUNING.least_corners:
        return []
    links = _mutual_links(saddles)
    return sorted(_walk(saddles, links), key=len, reverse=True)


def _mutual_links(saddles: Saddles) -> np.ndarray:
    """(n, 4, 2): for each corner and direction the neighbour and its direction back; -1: none."""
    neighbour, back = _chosen(saddles)
    links = np.full((len(saddles), 4, 2), -1)
    corner, direction = np.nonzero(neighbour >= 0)
    other, returning = neighbour[corner, direction], back[corner, direction]
    agrees = (neighbour[other, returning] == corner) & (back[other, returning] == direction)
    links[corner[agrees], direction[agrees], 0] = other[agrees]
    links[corner[agrees], direction[agrees], 1] = returning[agrees]
    return _without_long(saddles.pixels, links)


def _chosen(saddles: Saddles) -> tuple[np.ndarray, np.ndarray]:
    """Each corner's nearest fitting neighbour by direction (n, 4), and its direction back."""
    near, towards = _nearest(saddles.pixels)
    axes = saddles.directions[:, :2]
    axes = np.stack([np.cos(axes), np.sin(axes)], axis=-1).astype(np.float32)
    # Which of this corner's directions points to the other, and which of the other's points back.
    ahead, is_ahead = _closest_direction(axes[:, None], towards)
    behind, is_behind = _closest_direction(axes[near], -towards)
    fits = ((ahead + behind) % 2 == 1) & is_ahead & is_behind
    neighbour = np.full((len(saddles), 4), -1)
    back = np.full((len(saddles), 4), -1)
    for direction in range(4):
        usable = fits & (ahead == direction)
        best = np.argmax(usable, axis=1)  # the first one is the nearest
        rows = np.flatnonzero(usable[np.arange(len(near)), best])
        neighbour[rows, direction] = near[rows, best[rows]]
        back[rows, direction] = behind[rows, best[rows]]
    return neighbour, back


def _nearest(pixels: Array) -> tuple[np.ndarray, np.ndarray]:
    """The nearest corners of each (n, k), rising by distance, and unit vectors (n, k, 2) there."""
    spots = pixels.astype(np.float32)
    count = min(TUNING.nearest, len(pixels) - 1)
    # The nearest of all is the corner itself.
    distance, near = cv2.batchDistance(spots, spots, cv2.CV_32F, K=count + 1)
    distance, near = np.asarray(distance)[:, 1:], np.asarray(near, dtype=np.intp)[:, 1:]
    offset = spots[near] - spots[:, None]
    return near, offset / np.maximum(distance, np.float32(1e-6))[..., None]


def _closest_direction(axes: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the direction nearest to `towards` (…, 2), and whether it is near enough.

    `axes`: (…, 2, 2) unit vectors of directions 0 and 1; directions 2 and 3 are their opposites.
    """
    first, second = (
        axes[..., axis, 0] * towards[..., 0] + axes[..., axis, 1] * towards[..., 1]
        for axis in (0, 1)
    )
    is_second = np.abs(second) > np.abs(first)
    best = np.where(is_second, second, first)
    return is_second + 2 * (best < 0), np.abs(best) > TUNING.least_cosine


def _without_long(pixels: Array, links: np.ndarray) -> np.ndarray:
    """The links without those much longer than the opposite one at the same corner."""
    other = links[..., 0]
    length = np.linalg.norm(pixels[other] - pixels[:, None], axis=-1)
    length = np.where(other >= 0, length, np.inf)
    opposite = np.roll(length, 2, axis=1)
    too_long = (
        np.isfinite(length) & np.isfinite(opposite) & (length > TUNING.longest_ratio * opposite)
    )
    kept = links.copy()
    for corner, direction in zip(*np.nonzero(too_long), strict=True):
        neighbour, back = links[corner, direction]
        kept[corner, direction] = kept[neighbour, back] = -1
    return kept


def _walk(saddles: Saddles, links: np.ndarray) -> list[Grid]:
    """The connected grids of a link table that are large enough."""
    seen = [False] * len(links)
    count = (links[..., 0] >= 0).sum(axis=1)
    # A grid has a corner with two neighbours.
    order = np.argsort(-count, kind="stable")[: np.count_nonzero(count >= 2)]
    table, spots = links.tolist(), [complex(x, y) for x, y in saddles.pixels.tolist()]
    grids = []
    for seed in order.tolist():
        if not seen[seed]:
            placed = _walk_from(seed, table, seen, spots)
            if len(placed) >= TUNING.least_corners:
                grids.append(_grid(saddles, placed))
    return grids


def _walk_from(
    seed: int, links: list[list[list[int]]], seen: list[bool], spots: list[complex]
) -> dict[int, tuple[int, int, int]]:
    """Place (x, y) and turn of every corner that links reach from the seed, by corner.

    `turn`: which of the corner's own directions is the grid's x; `spots`: pixels as x + iy. A
    corner whose place is taken, or that would get two places, is left where it was first put; one
    that does not go on as the grid does belongs to another board.
    """
    placed = {seed: (0, 0, 0)}
    taken = {(0, 0): spots[seed]}
    seen[seed] = True
    waiting = deque([seed])
    while waiting:
        corner = waiting.popleft()
        x, y, turn = placed[corner]
        for direction, (neighbour, back) in enumerate(links[corner]):
            if neighbour < 0 or seen[neighbour]:
                continue
            step = (direction - turn) % 4
            place = (x + _STEPS[step][0], y + _STEPS[step][1])
            if place in taken or not _goes_on(taken, (x, y), _STEPS[step], spots[neighbour]):
                continue
            placed[neighbour] = (*place, (back - step - 2) % 4)
            taken[place] = spots[neighbour]
            seen[neighbour] = True
            waiting.append(neighbour)
    return placed


def _goes_on(
    taken: dict[tuple[int, int], complex],
    place: tuple[int, int],
    step: tuple[int, int],
    to: complex,
) -> bool:
    """Whether a step from a taken place leads `to` about where the grid's other steps say."""
    (x, y), (dx, dy), here = place, step, taken[place]
    for behind, ahead in (
        ((x - dx, y - dy), place),
        ((x + dy, y + dx), (x + dy + dx, y + dx + dy)),
        ((x - dy, y - dx), (x - dy + dx, y - dx + dy)),
    ):
        if behind in taken and ahead in taken:
            other = taken[ahead] - taken[behind]
            if abs(to - here - other) > TUNING.most_changed * abs(other):
                return False
    return True


def _grid(saddles: Saddles, placed: dict[int, tuple[int, int, int]]) -> Grid:
    indices = np.array(list(placed))
    values = np.array(list(placed.values()))
    # The sector from direction 2 to 3 of an unturned corner, (-x, -y), is light, as is 0 to 1.
    return Grid(values[:, :2], saddles.pixels[indices], values[:, 2] % 2 == 1)
