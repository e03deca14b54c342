"""The contract's noise of odometry, shared by robot, fusion and simulator."""

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise


class StepVariances(Struct, frozen=True):
    """Independent variances of steps (…): `translation` (…, 3), m², along, across and above the
    direction half-way through the step's turn; `rotation` (…, 3), rad², about the axes that the
    step starts from."""

    translation: Array
    rotation: Array


def step_variances(noise: OdometryNoise, length_m: ArrayLike, turn_rad: ArrayLike) -> StepVariances:
    """Variances of steps (…) of these lengths and absolute turns, as reported.

    Each step is an independent random walk with variances k² · (metres or radians travelled)
    (contract, section 2, «Odometry noise»; `vertical`, `tilt` and `tilt_turn` extend it to space).
    """
    length, turn = (np.asarray(value, dtype=float)[..., None] for value in (length_m, turn_rad))
    by_length = np.square([noise.tilt, noise.tilt, noise.heading_drive])
    by_turn = np.square([noise.tilt_turn, noise.tilt_turn, noise.heading_turn])
    return StepVariances(
        length * np.square([noise.distance, noise.lateral, noise.vertical]),
        length * by_length + turn * by_turn,
    )
