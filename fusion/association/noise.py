"""How noisy odometry and pictures are otherwise than the site file says."""

import math
from dataclasses import dataclass

from trigpoint.fusion.model.jitter import Jitter

# What a floor or a mast does where nothing is known of it: 0.3° and a millimetre (medians of an
# exponential prior).
TILT = math.radians(0.3)
SWAY = 1e-3
LEAST = 1e-3
"""Of these medians: nothing."""
# Noise is told in such steps of its logarithm: what is known finer changes nothing, and what was
# worked out by it can be kept when more pictures come in.
_STEP = 0.1


@dataclass(frozen=True, slots=True)
class Noise:
    """`tilt` (rad) and `sway` (m): standard deviations, in each picture, of the robot's turn about
    and its shift along each axis; `length` (m): over which a floor's slope changes, 0: it tilts
    anew in each picture; `odometry`: by what its stated sigmas are multiplied; `slip`: by what the
    slip of a robot that turns is, which nobody states."""

    tilt: float = 0.0
    sway: float = 0.0
    length: float = 0.0
    odometry: float = 1.0
    slip: float = 1.0

    @property
    def jitter(self) -> Jitter | None:
        """How the robot stands otherwise in a picture; None where it does not."""
        if self.tilt <= 0 and self.sway <= 0:
            return None
        tilt, sway = max(self.tilt, LEAST * TILT), max(self.sway, LEAST * SWAY)
        return Jitter(sway, tilt, self.length)


STATED = Noise()
# What a decision must survive where a session does not tell.
PESSIMISTIC = Noise(tilt=TILT, sway=SWAY, odometry=2.0, slip=2.0)


def in_steps(value: float) -> float:
    """A positive number, rounded to a tenth."""
    return math.exp(round(math.log(value) / _STEP) * _STEP) if value > 0 else value
