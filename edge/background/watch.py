"""Notices that a camera was turned or shifted, by its background alone.

A picture a second is held against the background; one that says «moved» is followed by others at
once, and all of them together decide.
"""

import math
from collections.abc import Sequence
from enum import StrEnum

import cv2
import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.geometry.rotation import Array

from .evidence import SURELY
from .motion import Motion
from .reference import Comparison, Reference
from .small_picture import WIDTH, small_picture
from .tiles import tiles_of

_PERIOD_NS = to_ns(1.0)
_SUSPICIOUS_NS = to_ns(0.4)
_YEAR_S = 365.25 * 86400
_DECISION = math.log(_YEAR_S) + math.log(100)
"""A camera is moved once a year, so a second sees that with a probability of 1 in 3·10⁷; it is said
where what speaks for it makes that 100 : 1."""
_MOST_A_PICTURE = _DECISION / 3 + 1e-9
"""What one picture may say of that, in either direction: pictures within a second resemble each
other, and at least three must agree."""
_ESTABLISHED = 30
"""So many pictures must have shown the background before anything can be said of it."""
_FORGOTTEN_NS = to_ns(3600.0)
"""A background of which nothing was seen for so long, by light in which there is as much to see, is
no more: the room was refurnished."""
_BEGUN_AGAIN_NS = to_ns(10.0)
"""The same before it is established: somebody stood in front."""
_AROUND = 1.5
"""What carries a target reaches beyond it: its outline is enlarged by this about its middle."""


class View(StrEnum):
    """What a camera sees of its background."""

    LEARNING = "learning"
    STILL = "still"
    HIDDEN = "hidden"
    SUSPECTED = "suspected"


class Nudge(Struct, frozen=True):
    """A camera was moved after `until_ns`, when it last stood as before, and not after `since_ns`.
    `shift`: of its picture, (across, down) in shares of the width; `roll`: rad."""

    until_ns: int
    since_ns: int
    shift: tuple[float, float]
    roll: float

    def words(self, horizontal_fov_deg: float) -> str:
        """It for people, through a lens of this field of view."""
        turn_deg = math.hypot(*self.shift) * horizontal_fov_deg
        percent = 100 * math.hypot(*self.shift)
        return (
            f"was turned or shifted: its picture by {percent:.1f} % of its width, as a turn of "
            f"{turn_deg:.1f} degrees does"
        )


class BackgroundWatch:
    """One camera's background; nothing of it leaves this object. For one thread.

    `view`: what the last picture showed; `nudge`: the last one; `count`: how many there were.
    """

    def __init__(self) -> None:
        self._reference: Reference | None = None
        self._shape: tuple[int, ...] = ()
        self._looked_ns: int | None = None
        self._still_ns = self._suspected_ns = 0
        self._suspicion = 0.0
        self.view = View.LEARNING
        self.nudge: Nudge | None = None
        self.count = 0
        self.last: Comparison | None = None

    @property
    def suspicion(self) -> float:
        """How much speaks for a nudge now: 0 nothing, 1 enough."""
        return self._suspicion / _DECISION

    @property
    def size_bytes(self) -> int:
        """Memory that the reference takes."""
        return 0 if self._reference is None else self._reference.size_bytes

    def look(self, picture: np.ndarray, stamp_ns: int, outlines: Sequence[Array] = ()) -> bool:
        """Take a picture, grey or BGR, uint8; whether it shows that the camera was moved.

        `outlines`: (n, 2) pixels each, of the targets in it, which are no background. Most pictures
        are passed over.
        """
        if not self._is_due(stamp_ns):
            return False
        self._looked_ns = stamp_ns
        small = small_picture(picture)
        usable = _usable(small.shape, outlines, WIDTH / picture.shape[1])
        if self._reference is None or picture.shape[:2] != self._shape:
            self._shape = picture.shape[:2]
            self._begin(small, usable, stamp_ns)
            return False
        comparison = self.last = self._reference.compare(small, usable)
        if self._weigh(comparison, stamp_ns):
            is_nudged = self._say(self._reference, comparison.motion)
            self._begin(small, usable, stamp_ns)
            return is_nudged
        if self.view is View.STILL:
            self._reference.learn(small, usable, comparison)
        elif self.view is View.HIDDEN and self._is_gone(small, usable, stamp_ns):
            self._begin(small, usable, stamp_ns)
        return False

    def _is_gone(self, small: np.ndarray, usable: np.ndarray, stamp_ns: int) -> bool:
        """Whether a hidden background is to be replaced by what is seen now."""
        hidden_ns = stamp_ns - self._still_ns
        if not self.is_established:
            return hidden_ns >= _BEGUN_AGAIN_NS
        if hidden_ns < _FORGOTTEN_NS:
            return False
        assert self._reference is not None
        return len(tiles_of(small, usable)) >= self._reference.count

    @property
    def is_established(self) -> bool:
        """Whether the background was seen often enough for anything to be said of it."""
        return self._reference is not None and self._reference.established >= _ESTABLISHED

    def _is_due(self, stamp_ns: int) -> bool:
        if self._looked_ns is None or stamp_ns < self._looked_ns:
            return True
        period_ns = _SUSPICIOUS_NS if self.view is View.SUSPECTED else _PERIOD_NS
        return stamp_ns - self._looked_ns >= period_ns

    def _begin(self, small: np.ndarray, usable: np.ndarray, stamp_ns: int) -> None:
        self._reference = Reference(small, usable)
        self._suspicion, self.view = 0.0, View.LEARNING
        self._still_ns = stamp_ns

    def _weigh(self, comparison: Comparison, stamp_ns: int) -> bool:
        """Add what a comparison says; whether that suffices."""
        evidence = comparison.evidence
        if self._suspicion == 0.0:
            self._suspected_ns = stamp_ns
        more = max(-_MOST_A_PICTURE, min(evidence.moved, _MOST_A_PICTURE))
        self._suspicion = max(0.0, self._suspicion + more)
        if evidence.still > SURELY:
            self._suspicion, self._still_ns, self.view = 0.0, stamp_ns, View.STILL
        else:
            self.view = View.SUSPECTED if self._suspicion else View.HIDDEN
        return self._suspicion >= _DECISION

    def _say(self, reference: Reference, motion: Motion) -> bool:
        """Note a nudge; whether it is one. Before a background is established, a move belongs to
        the nudge before, or to the camera's being put up."""
        until_ns = self._still_ns
        if not self.is_established:
            if self.nudge is None:
                return False
            until_ns = self.nudge.until_ns
        across, down, roll = reference.turn(motion).tolist()
        self.nudge = Nudge(until_ns, self._suspected_ns, (across, down), roll)
        self.count += 1
        return True


def _usable(shape: Sequence[int], outlines: Sequence[Array], scale: float) -> np.ndarray:
    """(h, w) of a small picture: where there is no target."""
    covered = np.zeros(shape, np.uint8)
    for outline in outlines:
        middle = outline.mean(axis=0)
        around = scale * (middle + _AROUND * (outline - middle))
        cv2.fillConvexPoly(covered, cv2.convexHull(np.rint(around).astype(np.int32)), 1)
    return covered == 0
