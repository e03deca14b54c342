"""What a comparison with the background says, as logarithms of likelihoods.

A tile is seen where it was, or where the common motion of the others puts it, or neither. Three
things may be so: the camera stands still, it was moved, or its view is hidden (by people, by the
dark, in another light), so that what is found is found by chance. How often a tile is seen in each
way under each of the three is all that is assumed, and stated here.
"""

import math

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

from .motion import Motion
from .tiles import SIGMA_PX, Matches

_VISIBLE = np.array([0.9, 0.6, 0.3, 0.1])
"""Which share of the background shows is not known; the likeliest of these is taken."""
_ASTRAY = 0.05
"""A tile shows the other of standing and having been moved: a door, a shadow, a chance match."""
_BY_CHANCE = (0.01, 0.06)
"""A tile that shows nothing of the background is found where it was, or where the motion puts it,
which is chosen so that most agree."""
SURELY = math.log(20)
"""What makes one of the three 20 : 1."""
_TILES_A_THING = 3.0
"""So many neighbouring tiles are one witness: what covers or moves one mostly does all of them."""
_GATE = -2 * math.log(0.01)
"""The squared distance (two degrees of freedom) that a tile's place exceeds once in a hundred."""
_LEAST_TELLING = 4
_LEAST_RADIUS_PX = 20.0
_QUANTILES = np.linspace(0.1, 0.9, 9)
_MOST_FOCUSING = 0.03
"""By this share a lens zooms at most when it focuses."""
_PARALLAX, _MOST_PARALLAX_PX = 0.25, 1.0
"""By this share of it the motion of a tile may differ from the others': near things shift more."""


def _table(here: Array, there: Array) -> Array:
    """ln P of (here, there, neither) for each visible share, (v, 3)."""
    return np.log(np.stack([here, there, 1 - here - there], axis=1))


_ODD = np.full(len(_VISIBLE), _ASTRAY)
_STILL, _MOVED = _table(_VISIBLE, _ODD), _table(_ODD, _VISIBLE)
_HIDDEN = _table(*(np.array([share]) for share in _BY_CHANCE))


class Evidence(Struct, frozen=True):
    """`moved`: ln of how much likelier a comparison is where the camera was moved than under the
    likelier one of the other two; `still`: the same of standing still. The tiles' numbers: where
    they were, moved along, and neither."""

    moved: float
    still: float
    here: int
    there: int
    neither: int


def evidence_of(here: np.ndarray, there: np.ndarray, seen: np.ndarray) -> Evidence:
    """The evidence of tiles, (n,) bool each: `seen` those that could be looked for, of which none
    is both `here` and `there`."""
    counts = np.array([here.sum(), there.sum(), (seen & ~here & ~there).sum()])
    still, moved, hidden = (
        float((table @ counts).max()) / _TILES_A_THING for table in (_STILL, _MOVED, _HIDDEN)
    )
    is_moved, is_still = moved - max(still, hidden), still - max(moved, hidden)
    return Evidence(is_moved, is_still, *counts.tolist())


def at_home(matches: Matches) -> np.ndarray:
    """(n,) whether each tile is found where it was."""
    return matches.is_found & (matches.distances(np.zeros(2)) < _GATE)


def still_evidence(here: np.ndarray) -> Evidence:
    """The evidence of tiles (n,) most of which are found where they were."""
    return evidence_of(here, np.zeros_like(here), np.ones_like(here))


def weighed(matches: Matches, motion: Motion, middle: Array) -> tuple[Evidence, np.ndarray]:
    """What tiles say under the likeliest motion, and (n,) which are where they were but for the
    lens's focusing. A tile that such a motion hardly shifts, or that focusing shifts as much, says
    nothing of it."""
    offsets = matches.middles - middle
    expected = motion.shifts(offsets)
    to_motion = matches.distances(expected)
    parallax = np.minimum(_PARALLAX * np.linalg.norm(expected, axis=1), _MOST_PARALLAX_PX)
    is_near = np.linalg.norm(matches.shifts - expected, axis=1) < parallax
    agrees = matches.is_found & (is_near | (to_motion < _GATE))
    lenses = [np.zeros_like(offsets), focusing(matches, offsets) * offsets]
    to_lens = np.min([matches.distances(lens) for lens in lenses], axis=0)
    home = matches.is_found & (to_lens < _GATE)
    apart = np.min([matches.apart(lens, expected) for lens in lenses], axis=0)
    nominal = np.min([np.sum((lens - expected) ** 2, axis=1) for lens in lenses], axis=0)
    tells = np.where(matches.is_found, apart, nominal / SIGMA_PX**2) > _GATE
    if np.count_nonzero(tells & matches.is_found) < _LEAST_TELLING:
        return evidence_of(home, np.zeros_like(home), matches.is_inside), home
    agrees &= to_motion < to_lens
    here, there = home & ~agrees & tells, agrees & tells
    return evidence_of(here, there, matches.is_inside & tells), home & ~agrees


def focusing(matches: Matches, offsets: Array) -> float:
    """The zoom that explains most tiles alone, as far as lenses zoom when they focus; `offsets`:
    (n, 2) of the tiles from the middle. Each tile gives one that may be it."""
    rows = matches.is_found & (np.linalg.norm(offsets, axis=1) > _LEAST_RADIUS_PX)
    if not rows.any():
        return 0.0
    along = np.sum(matches.shifts[rows] * offsets[rows], axis=1)
    single = along / np.sum(offsets[rows] ** 2, axis=1)
    tried = np.quantile(single, _QUANTILES).clip(-_MOST_FOCUSING, _MOST_FOCUSING).tolist()
    homes = [
        np.count_nonzero(matches.is_found & (matches.distances(zoom * offsets) < _GATE))
        for zoom in tried
    ]
    return tried[int(np.argmax(homes))]
