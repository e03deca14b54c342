"""How a robot in a picture stands off the plane of its odometry."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array

from .thinning import thinned

# A floor turns nobody's heading by as much (rad).
_EVEN = 1e-6
# Beyond so many pictures a part of them says how many stand alike.
_MOST_PLACES = 1000


@dataclass(frozen=True, slots=True)
class Jitter:
    """`sway` (m), `tilt` (rad): standard deviations of the robot's shift along and its turn about
    each axis in a picture; `length` (m): over which a floor's slope changes, so that pictures taken
    within it share the tilt, which does not turn the heading; 0: it tilts in each picture anew."""

    sway: float
    tilt: float
    length: float = 0.0

    @property
    def variances(self) -> Array:
        """(6,), of one picture."""
        heading = min(_EVEN, self.tilt) if self.length > 0 else self.tilt
        return np.array([self.sway, self.sway, self.sway, self.tilt, self.tilt, heading]) ** 2

    def among(self, places: Array) -> Array:
        """The variances (n, 6) by which pictures taken at places (n, 3) may be weighed as though
        each stood for itself: a tilt that m of them share is m times as large in each, so that
        all of them together are no better than one."""
        variances = np.tile(self.variances, (len(places), 1))
        if self.length > 0:
            some = places[thinned(len(places), _MOST_PLACES)]
            apart = np.linalg.norm(places[:, None] - some, axis=-1)
            alike = np.exp(-apart / self.length).mean(axis=1) * len(places)
            variances[:, 3:5] *= np.maximum(alike, 1.0)[:, None]
        return variances
