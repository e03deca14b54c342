"""Rolling shutters: a picture's rows are exposed one after the other, and the robot drives on.

The stamp is the middle row's. An observation's own moment is that at which the middle of its
corners was exposed, so that odometry leads to there and not to where the picture's middle row was.
About that moment the robot goes on with the twist ξ = (v, ω) that its odometry has then, in base
axes: a corner p, whose row comes t later, is seen where Exp(ξ t) p ≈ p + t (v + ω × p) would be
seen at the observation's moment (Ait-Aider et al., «Simultaneous object pose and velocity
computation using a single view from a rolling shutter camera», 2006). What is left out is
(ω t)² |p| / 2, less than 10 µm for what a robot does in 5 ms.

So a corner's place in the base frame is all that changes, and that before anything is solved: every
prediction of a corner, and every derivative of it, holds as it is.
"""

from dataclasses import dataclass, replace

import numpy as np

from trigpoint.config import CameraConfig
from trigpoint.geometry.rotation import Array


@dataclass(frozen=True, slots=True)
class Sweep:
    """When a view's corners were exposed, and how the robot moved then.

    `after_s` (n,): after the observation's moment, or after the picture's stamp as long as there is
    no observation; `twist`: the robot's, (6,) or one a corner (n, 6), m/s and rad/s in base axes.
    """

    after_s: Array
    twist: Array

    def moving(self, twist: Array) -> "Sweep":
        """The same of a robot that moves by a twist (6,)."""
        return replace(self, twist=twist)

    def later(self, seconds: float) -> "Sweep":
        """The same after a moment so much later."""
        return replace(self, after_s=self.after_s - seconds)

    def where(self, chosen: np.ndarray) -> "Sweep":
        """Of the chosen (n,) bool corners."""
        twist = self.twist[chosen] if self.twist.ndim > 1 else self.twist
        return Sweep(self.after_s[chosen], twist)

    def shift(self, points: Array) -> Array:
        """How far corners (…, n, 3) of the base frame go until they are exposed, metres."""
        speed = self.twist[..., :3] + np.cross(self.twist[..., 3:], points)
        return self.after_s[:, None] * speed


def sweep_of(camera: CameraConfig, pixels: Array) -> Sweep | None:
    """The sweep of corners (n, 2) after their picture's stamp, by a robot of which nothing is known
    yet; None where all rows are exposed at once."""
    if camera.line_delay == 0:
        return None
    return Sweep(camera.line_delay * (pixels[:, 1] - (camera.height - 1) / 2), np.zeros(6))
