"""What a camera's still background looks like: tiles, renewed while it stands still."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

from .evidence import SURELY, Evidence, at_home, still_evidence, weighed
from .motion import Motion, coarse_shift, motion_of
from .tiles import CELL, HALF, REACH, Matches, Tiles, around, match, tiles_of

_PLAIN_SHARE = 0.6
"""Where more of the tiles are where they were, they are looked for nowhere else."""
_NEWEST_SHARE = 1 / 16
"""What the newest picture counts for in a tile: light that changes in a minute is followed."""
_MOST_MISSES = 30
"""A tile that was not where it was so often in a row is given up: a thing was put there."""
_RENEWED_EVERY = 30
"""New tiles are looked for every so many pictures that are learnt."""
_MOST_ZOOM = 0.003
"""Nothing is learnt while the lens is focused further than this from where it was."""


class Comparison(Struct, frozen=True, eq=False):
    """`motion`: the likeliest one; `looked`: which tiles were looked at, `here`: which of those
    were where they belong."""

    evidence: Evidence
    motion: Motion
    looked: np.ndarray
    here: np.ndarray


class Reference:
    """The background of one camera that stands still. For one thread.

    `established`: how many pictures showed it so far.
    """

    def __init__(self, small: np.ndarray, is_usable: np.ndarray) -> None:
        """`small`: the first small picture (h, w); `is_usable`: (h, w), without what is no
        background."""
        self._small = small
        self._middle = (np.array(small.shape[::-1]) - 1) / 2
        self._tiles = tiles_of(small, is_usable)
        self._counts = np.ones(len(self._tiles), int)
        self._misses = np.zeros(len(self._tiles), int)
        self.established = 0

    @property
    def count(self) -> int:
        """How many tiles it has."""
        return len(self._tiles)

    @property
    def size_bytes(self) -> int:
        """Memory that it takes."""
        return self._small.nbytes + self._tiles.patches.nbytes + self._tiles.middles.nbytes

    def compare(self, small: np.ndarray, is_usable: np.ndarray) -> Comparison:
        """Hold a small picture against the background; further and further from where the tiles
        were, as long as that explains nothing."""
        x, y = self._tiles.middles.T
        looked = is_usable[y, x]
        tiles = self._tiles.at(looked)
        at_place = match(tiles, small, reach=1)
        here = at_home(at_place)
        if here.sum() > _PLAIN_SHARE * len(tiles):
            return Comparison(still_evidence(here), Motion.none(), looked, here)
        near = self._explained(match(tiles, small), looked)
        if near.evidence.still > SURELY or not len(tiles):
            return near
        starts = [np.rint(near.motion.shift).astype(int)]  # some tiles were just out of reach
        if near.evidence.moved < SURELY:
            starts.append(coarse_shift(self._small, small))
        found = [self._explained(match(tiles, small, start=s), looked) for s in starts if s.any()]
        return max([near, *found], key=lambda each: each.evidence.moved)

    def _explained(self, matches: Matches, looked: np.ndarray) -> Comparison:
        motion = motion_of(matches, self._middle) or Motion.none()
        evidence, here = weighed(matches, motion, self._middle)
        return Comparison(evidence, motion, looked, here)

    def learn(self, small: np.ndarray, is_usable: np.ndarray, comparison: Comparison) -> None:
        """Renew the tiles by a picture that shows the camera standing still."""
        if abs(comparison.motion.zoom) > _MOST_ZOOM:
            return
        self.established += 1
        self._small = small
        rows = np.flatnonzero(comparison.looked)
        seen, missed = rows[comparison.here], rows[~comparison.here]
        self._blend(small, seen)
        self._misses[seen] = 0
        self._misses[missed] += 1
        if self.established % _RENEWED_EVERY == 0:
            self._renew(small, is_usable)

    def _blend(self, small: np.ndarray, rows: np.ndarray) -> None:
        self._counts[rows] += 1
        shares = np.maximum(1 / self._counts[rows], _NEWEST_SHARE)
        now = around(small, self._tiles.middles[rows], HALF)
        patches = self._tiles.patches
        patches[rows] += (shares[:, None, None] * (now - patches[rows])).astype(np.float32)

    def _renew(self, small: np.ndarray, is_usable: np.ndarray) -> None:
        """Give up tiles that are gone, and take new ones in cells that have none."""
        kept = self._misses < _MOST_MISSES
        tiles, new = self._tiles.at(kept), tiles_of(small, is_usable)
        taken = {tuple(cell) for cell in _cells(tiles.middles).tolist()}
        is_new = np.array([tuple(c) not in taken for c in _cells(new.middles).tolist()], bool)
        new = new.at(is_new)
        self._tiles = Tiles(
            np.concatenate([tiles.middles, new.middles]),
            np.concatenate([tiles.patches, new.patches]),
        )
        self._counts = np.concatenate([self._counts[kept], np.ones(len(new), int)])
        self._misses = np.concatenate([self._misses[kept], np.zeros(len(new), int)])

    def turn(self, motion: Motion) -> Array:
        """What a motion is as shares of the picture's width: (across, down), and the roll, rad."""
        return np.array([*(motion.shift / self._small.shape[1]), motion.roll])


def _cells(middles: np.ndarray) -> np.ndarray:
    return (middles - (HALF + REACH + 1)) // CELL
