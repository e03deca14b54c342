"""Rolling shutters: a picture's rows are exposed one after the other, and the robot drives on.

The stamp is the middle row's. An observation's own moment is that at which the middle of its
corners was exposed, so that odometry refers to that moment and not to the picture's middle row.
About that moment the robot moves with the twist ξ = (v, ω) that its odometry has then, in base
axes: a corner p, whose row comes t later, is seen where Exp(ξ t) p ≈ p + t (v + ω × p) would be
seen at the observation's moment (Ait-Aider et al., «Simultaneous object pose and velocity
computation using a single view from a rolling shutter camera», 2006). What is left out is
(ω t)² |p| / 2, less than 10 µm for what a robot does in 5 ms.

So only a corner's position in the base frame changes, and that before anything is solved: the
predictions of corners, and their derivatives, are the same as without a rolling shutter.
"""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.geometry.rotation import Array
from trigpoint.site.config import CameraConfig


class Sweep(Struct, frozen=True):
    """When a view's corners were exposed, and how the robot moved then.

    `after_s` (n,): the exposure times after the observation's moment, or after the picture's stamp
    before there is an observation; `twist`: the robot's, (6,) or one for each corner (n, 6), m/s
    and rad/s in base axes.
    """

    after_s: Array
    twist: Array

    def moving(self, twist: Array) -> "Sweep":
        """The same sweep with the robot's twist (6,)."""
        return replace(self, twist=twist)

    def later(self, seconds: float) -> "Sweep":
        """The same sweep, referred to a moment this much later."""
        return replace(self, after_s=self.after_s - seconds)

    def where(self, chosen: np.ndarray) -> "Sweep":
        """The sweep of the corners selected by a mask (n,) bool."""
        twist = self.twist[chosen] if self.twist.ndim > 1 else self.twist
        return Sweep(self.after_s[chosen], twist)

    def shift(self, points: Array) -> Array:
        """The displacement of corners (…, n, 3), base frame, until they are exposed, metres."""
        speed = self.twist[..., :3] + np.cross(self.twist[..., 3:], points)
        return self.after_s[:, None] * speed


def sweep_of(camera: CameraConfig, pixels: Array) -> Sweep | None:
    """The sweep of corners with pixels (n, 2), referred to their picture's stamp and with a zero
    twist until the robot's is known; None where all rows are exposed at once."""
    if camera.line_delay == 0:
        return None
    return Sweep(camera.line_delay * (pixels[:, 1] - (camera.height - 1) / 2), np.zeros(6))
