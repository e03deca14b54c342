"""Corners of a moving target as a rolling shutter's middle row would have seen them all.

Every row is exposed `line_delay` after the one above it, so a target that moves is bent, and a lens
that is fitted to bent boards is wrong. How fast each corner moves, the picture before says.
"""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from trigpoint.base.clock import to_seconds
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry.rotation import Array

from .calibration_views import FEWEST_CORNERS

# Motion between pictures farther apart says little of that within one.
_LONGEST_GAP_S = 0.5
# A face that seems to have gone farther than this share of its size is another one, or was read
# from its other end.
_FARTHEST_SHARE = 0.5


class ShutterCorrection:
    """Takes the motion during the readout out of sightings; `line_delay_s`: from row to row, 0 of a
    global shutter, whose sightings are left as they are. For one thread."""

    def __init__(self, line_delay_s: float) -> None:
        self._line_delay_s = line_delay_s
        self._before: tuple[FaceSighting, ...] = ()
        self._before_ns = 0

    def corrected(
        self, faces: Sequence[FaceSighting], height: int, stamp_ns: int
    ) -> tuple[FaceSighting, ...]:
        """The sightings of a picture of `height` rows as of one moment; those whose motion is not
        known are left out."""
        if self._line_delay_s == 0:
            return tuple(faces)
        before, gap_s = self._before, to_seconds(stamp_ns - self._before_ns)
        self._before, self._before_ns = tuple(faces), stamp_ns
        if not 0 < gap_s <= _LONGEST_GAP_S:
            return ()
        found = [self._at_once(face, before, height, gap_s) for face in faces]
        return tuple(face for face in found if face is not None)

    def _at_once(
        self, face: FaceSighting, before: Sequence[FaceSighting], height: int, gap_s: float
    ) -> FaceSighting | None:
        moved = [way for other in before if (way := _way(other, face)) is not None]
        if not moved:
            return None
        ids, way = min(moved, key=lambda known: float(np.median(np.linalg.norm(known[1], axis=1))))
        seen = face.pixels[ids].astype(float)
        if np.median(np.linalg.norm(way, axis=1)) > _FARTHEST_SHARE * np.ptp(seen, axis=0).max():
            return None
        late_s = self._line_delay_s * (seen[:, 1] - (height - 1) / 2)
        pixels = seen - way / gap_s * late_s[:, None]
        return replace(face, corners=face.corners[ids], pixels=pixels.astype(np.float32))


def _way(before: FaceSighting, face: FaceSighting) -> tuple[np.ndarray, Array] | None:
    """Which corners (n,) of a face another sighting has too, and how far they moved since, (n, 2)
    pixels; None where it is of another face."""
    if (before.target, before.face) != (face.target, face.face):
        return None
    _, own, others = np.intersect1d(face.corners, before.corners, return_indices=True)
    if len(own) < FEWEST_CORNERS:
        return None
    return own, face.pixels[own].astype(float) - before.pixels[others]
