"""The random deviation of a robot's pose in a picture from the plane of its odometry."""

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

from .thinning import thinned

# An uneven floor turns a robot's heading by less than this (rad).
_EVEN = 1e-6
# With more pictures than this, a subset of them tells how many share a tilt.
_MOST_PLACES = 1000


class Jitter(Struct, frozen=True):
    """`sway` (m), `tilt` (rad): standard deviations of the robot's shift along and rotation about
    each axis in a picture; `length` (m): the correlation length of the floor's slope: pictures
    taken within it share the tilt, which does not turn the heading; 0: independent tilts."""

    sway: float
    tilt: float
    length: float = 0.0

    @property
    def variances(self) -> Array:
        """The variances (6,) in one picture."""
        heading = min(_EVEN, self.tilt) if self.length > 0 else self.tilt
        return np.array([self.sway, self.sway, self.sway, self.tilt, self.tilt, heading]) ** 2

    def among(self, places: Array) -> Array:
        """The variances (n, 6) with which pictures taken at places (n, 3) may be treated as
        independent: a tilt that m of them share has m times its variance in each, so that
        together they are worth no more than one."""
        variances = np.tile(self.variances, (len(places), 1))
        if self.length > 0 and len(places) > 1:
            centred = places - places.mean(axis=0)
            some = centred[thinned(len(places), _MOST_PLACES)]
            squares = np.sum(centred**2, axis=1)[:, None] + np.sum(some**2, axis=1)
            apart = np.sqrt(np.maximum(squares - 2 * centred @ some.T, 0.0))
            alike = np.exp(-apart / self.length).mean(axis=1) * len(places)
            variances[:, 3:5] *= np.maximum(alike, 1.0)[:, None]
        return variances

    def in_pictures(self, places: Array) -> Array:
        """The variances (n, 2, 6) `among` pictures taken at places (n, 3), and those in each by
        itself."""
        among = self.among(places)
        return np.stack([among, np.broadcast_to(self.variances, among.shape)], axis=1)
