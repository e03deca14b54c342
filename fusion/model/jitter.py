"""How a robot in a picture stands off the plane of its odometry."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Jitter:
    """`sway` (m), `tilt` (rad): standard deviations of the robot's shift along and its turn about
    each axis, in each picture anew; `is_floor`: the tilt is that of the place, so that all pictures
    of a robot that stands share it."""

    sway: float
    tilt: float
    is_floor: bool = False

    @property
    def variances(self) -> Array:
        """(6,), of one picture."""
        return np.repeat([self.sway**2, self.tilt**2], 3)
