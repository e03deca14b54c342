"""A robot's true way about what it reports, by the letter of the contract's noise model.

`odometry.reported` draws the report about a smooth truth, which suits a lab whose pictures are to
be the same for every seed. An estimator takes the contract at its word: it has the truth scatter
about the report. The two differ where the way between two messages matters: a rough report about a
smooth truth seems to tell when a picture was taken, and does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trigpoint.contract.odometry_noise import step_variances
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise

from .odometry import half_turned


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """True poses `map_from_base` (n) at moments `stamps_s` (n,) that hold every odometry message
    and every picture, and the scale errors (2,) that the report has."""

    stamps_s: Array
    map_from_base: Pose
    scale_errors: Array

    def at(self, t_s: ArrayLike) -> Pose:
        """The pose at world times (…): exact at the stamps, the same share of a step's motion in
        between, held at both ends."""
        t = np.clip(np.asarray(t_s, dtype=float), self.stamps_s[0], self.stamps_s[-1])
        before = np.searchsorted(self.stamps_s, t, "right") - 1
        before = np.clip(before, 0, len(self.stamps_s) - 2)
        gap = self.stamps_s[before + 1] - self.stamps_s[before]
        share = (t - self.stamps_s[before]) / gap
        start, end = self.map_from_base[before], self.map_from_base[before + 1]
        return start.disturbed(end.difference(start) * share[..., None])


def scattered(
    steps: Array, noise: OdometryNoise, scale_errors: Array, random: np.random.Generator
) -> Array:
    """True motion (n, 3) x, y, heading of reported `steps` (n, 3), each in the frame it starts
    from: the report with its scale errors and the contract's independent noise."""
    clean = steps * (1 + scale_errors[[0, 0, 1]])
    variances = step_variances(noise, np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2]))
    draw = random.standard_normal(steps.shape)
    shift = half_turned(np.sqrt(variances.translation[:, :2]) * draw[:, :2], steps[:, 2])
    return clean + np.column_stack([shift, np.sqrt(variances.rotation[:, 2]) * draw[:, 2]])
