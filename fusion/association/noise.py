"""The noise of odometry and of the robot's pose in pictures that the site file does not state."""

import math

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.odometry import PARTS

# The medians of the exponential priors on the tilt by a floor and the sway of a mast: 0.3° and a
# millimetre.
TILT = math.radians(0.3)
SWAY = 1e-3
LENGTH = 1.0
"""Over so many metres, within a factor of e, the slope of a floor changes."""
LEAST = 1e-3
"""The share of these medians that is as good as none."""
# Learnt noise is rounded to such steps of its logarithm: finer differences change nothing, and what
# was computed with it stays cached when more pictures come in.
_STEP = 0.1


class Noise(Struct, frozen=True):
    """The noise of one robot.

    `tilt` (rad), `sway` (m): standard deviations, in each picture, of the robot's rotation about
    and its shift along each axis; `length` (m): the correlation length of the floor's slope, 0: the
    tilts of pictures are independent; `odometry`: the factor on its stated sigmas; `slip`: the
    factor on the slip of a turning robot, which no site file states.
    """

    tilt: float = 0.0
    sway: float = 0.0
    length: float = 0.0
    odometry: float = 1.0
    slip: float = 1.0

    @property
    def jitter(self) -> Jitter | None:
        """The deviation of the robot's pose in a picture from its odometry; None without any."""
        if self.tilt <= 0 and self.sway <= 0:
            return None
        tilt, sway = max(self.tilt, LEAST * TILT), max(self.sway, LEAST * SWAY)
        return Jitter(sway, tilt, self.length)


STATED = Noise()
# A decision must hold under this noise too where the session does not determine its own.
PESSIMISTIC = Noise(tilt=TILT, sway=SWAY, odometry=2.0, slip=2.0)


def on_a_floor(noise: Noise, slope: float) -> Noise:
    """Return a noise in which nothing tilts, on a floor of such a root mean square slope (rad)."""
    return replace(noise, tilt=slope, length=LENGTH) if slope > LEAST * TILT else noise


def in_steps(value: float) -> float:
    """Return a number, if positive, with its logarithm rounded to steps of a tenth."""
    return math.exp(round(math.log(value) / _STEP) * _STEP) if value > 0 else value


def with_noise(data: DataSet, noise: dict[str, Noise]) -> DataSet:
    """Return a copy of the data set with each robot's noise as learnt; the original is kept."""
    tracks, jitter = dict(data.tracks), {}
    for robot, learnt in noise.items():
        stated = data.site.robots[robot].odometry
        factor = learnt.odometry
        scaled = {part: getattr(stated, part) * factor for part in PARTS}
        track = data.tracks[robot]
        tracks[robot] = track.noisy(
            msgspec.structs.replace(stated, **scaled),
            slip=track.slip * learnt.slip,
            skid=track.skid * learnt.odometry,
        )
        if learnt.jitter is not None:
            jitter[robot] = learnt.jitter
    return replace(data, tracks=tracks, jitter=jitter)
