"""Puts markers that may be right together to boards: those that agree on where the board lies."""

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.edge.image.time_limit import IsOver, never
from trigpoint.geometry.rotation import Array

from .markers import Markers
from .quads import mapped, square_to_quads

# Correlations of a marker's cells: to start a board, to join one, and to be one all alone. Dark
# clutter reaches 0.6 with the best of a few hundred markers, never twice at agreeing places.
LEAST_SEED = 0.6
LEAST_MEMBER = 0.45
LEAST_ALONE = 0.8
LEAST_MEAN = 0.6
# How far a member's corners may lie from where the others put them, of the marker's side,
NEAR = 0.3
# and how far a new member may be from the nearest old one, of the marker's side.
STEP = 3.5
MOST_GROUPS = 8
# Of the likeliest markers, how many are looked at, and how many are tried as the start of a board.
MOST_MARKERS = 400
MOST_SEEDS = 64


class MarkerGroup(Struct, frozen=True):
    """Markers of one board in one place. `numbers`: (k,); `corners`: (k, 4, 2) pixels; `quads`:
    (k,) which quadrilaterals; `weight`: the sum of scores, to choose among groups that share any.
    """

    numbers: np.ndarray
    corners: Array
    quads: np.ndarray
    weight: float


def group_markers(markers: Markers, layout: Array, is_over: IsOver = never) -> list[MarkerGroup]:
    """The boards that markers show, heaviest first; several where one look is seen several times.

    `layout`: (m, 4, 2) the markers' corners on the board, clockwise from the top left.
    """
    groups: list[MarkerGroup] = []
    markers = markers.first(MOST_MARKERS)
    free = np.ones(len(markers), dtype=bool)
    seeds = min(int(np.count_nonzero(markers.scores >= LEAST_SEED)), MOST_SEEDS)
    if seeds == 0:
        return groups
    has_company = _has_company(seeds, markers, layout)
    for seed in range(seeds):
        if len(groups) == MOST_GROUPS or is_over():
            break
        if not free[seed]:
            continue
        members = _gathered(seed, markers, layout, free) if has_company[seed] else np.array([seed])
        free[members] = False
        scores = markers.scores[members]
        if scores.mean() >= (LEAST_MEAN if len(members) > 1 else LEAST_ALONE):
            groups.append(
                MarkerGroup(
                    markers.numbers[members],
                    markers.corners[members],
                    markers.quads[members],
                    float(scores.sum()),
                )
            )
    return sorted(groups, key=lambda group: -group.weight)


def _has_company(seeds: int, markers: Markers, layout: Array) -> np.ndarray:
    """Whether any other marker lies where each of the first `seeds` has it, (seeds,) bool."""
    own = layout[markers.numbers[:seeds]]
    # Markers are printed square and all one way up: others in this one's axes, from its corner 0.
    axes = np.stack([layout[0, 1] - layout[0, 0], layout[0, 3] - layout[0, 0]], axis=-1)
    places = (layout[markers.numbers][None] - own[:, None, None, 0]) @ np.linalg.inv(axes).T
    expected = mapped(square_to_quads(markers.corners[:seeds]), places.reshape(seeds, -1, 2))
    expected = expected.reshape(seeds, -1, 4, 2)
    off = np.linalg.norm(markers.corners - expected, axis=-1).mean(axis=-1)
    near = off < NEAR * _sides(expected)
    near &= np.linalg.norm(places.mean(axis=2) - 0.5, axis=-1) < STEP
    near &= markers.numbers[:seeds, None] != markers.numbers
    return near.any(axis=1)


def _sides(quads: Array) -> Array:
    """How large quads (…, 4, 2) are, (…,): never 0, whatever became of them."""
    return np.maximum(np.linalg.norm(quads[..., 2, :] - quads[..., 0, :], axis=-1), 1e-9) / np.sqrt(
        2
    )


def _gathered(seed: int, markers: Markers, layout: Array, free: np.ndarray) -> np.ndarray:
    """The seed and every free marker that agrees with it, indices (k,)."""
    centres = layout.mean(axis=1)
    side = np.linalg.norm(layout[0, 1] - layout[0, 0])
    members = [seed]
    while True:
        numbers = markers.numbers[members]
        fit, _ = cv2.findHomography(
            layout[numbers].reshape(-1, 2), markers.corners[members].reshape(-1, 2), 0
        )
        if fit is None:
            return np.array(members)
        others = np.flatnonzero(free & ~np.isin(markers.numbers, numbers))
        steps = np.linalg.norm(centres[markers.numbers[others]][:, None] - centres[numbers], axis=2)
        others = others[steps.min(axis=1) < STEP * side]
        added = _agreeing(others, markers, layout, fit.astype(float))
        if not added:
            return np.array(members)
        members += added


def _agreeing(others: np.ndarray, markers: Markers, layout: Array, fit: Array) -> list[int]:
    """Those of `others` that lie where the fit puts them, the nearest one for each number."""
    if len(others) == 0:
        return []
    expected = np.asarray(cv2.perspectiveTransform(layout[markers.numbers[others]], fit), float)
    off = np.linalg.norm(markers.corners[others] - expected, axis=-1).mean(axis=1)
    off = off / _sides(expected)
    best: dict[int, tuple[float, int]] = {}
    for index, distance in zip(others.tolist(), off.tolist(), strict=True):
        number = int(markers.numbers[index])
        if distance < NEAR and distance < best.get(number, (NEAR, 0))[0]:
            best[number] = (distance, index)
    return [index for _, index in best.values()]
