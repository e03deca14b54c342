"""How improbable a visit is under a noise model, and in which of its steps an event is likelier."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .events import Events
from .linear import EQUATIONS, Linear
from .noise import Noise

_STEADY = Jitter(0.0, 0.0)
_REAL = np.float64
_MISFIT = Kernel(
    "tp_misfit",
    *EQUATIONS,
    In(_REAL, ("n", 3)),
    *(In(_REAL, ("m", "d", "d")), In(_REAL, ("m", "d", "d")), In(_REAL, ("m", "d", "d"))),
    *(In(_REAL, (6,)), float, float, float, float),
    *(Out(_REAL, (1,)), Out(_REAL, (5,)), Out(_REAL, ("m",))),
)


class Misfit(Struct, frozen=True):
    """How improbable a visit is under a noise model: `value`, -2 ln of its restricted likelihood up
    to a constant, infinite where the visit determines none; `by_noise` (5,): its derivatives by the
    logarithms of the model's numbers, in their order; `by_step` (m,): by how much χ² is lower
    without each step."""

    value: float
    by_noise: Array
    by_step: Array


def misfit(visit: Linear, noise: Noise) -> Misfit:
    """The misfit of a visit under a noise model."""
    jitter = noise.jitter or _STEADY
    value, by_noise, by_step = np.empty(1), np.empty(5), np.empty(len(visit.steps))
    is_determined = _MISFIT(
        *visit.equations,
        *(visit.places, visit.by_odometry, visit.by_slip, visit.broken),
        *(jitter.variances, jitter.tilt, jitter.length, noise.odometry, noise.slip),
        *(value, by_noise, by_step),
    )
    if not is_determined:
        return Misfit(np.inf, np.zeros(5), np.zeros(len(visit.steps)))
    return Misfit(float(value[0]), by_noise, by_step)


def interrupted(visit: Linear, noise: Noise, events: Events) -> tuple[Linear, int]:
    """The visit with those steps broken in which, under this noise, an event (a lift, a moved
    camera) is likelier than so large an error of odometry, and the number of these steps."""
    before, count = misfit(visit, noise), 0
    while count < len(visit.steps):
        other = _broken(visit, int(np.argmax(before.by_step)), events)
        after = misfit(other, noise)
        if not after.value + events.event_score < before.value:
            break
        visit, before, count = other, after, count + 1
    return visit, count


def _broken(visit: Linear, step: int, events: Events) -> Linear:
    """The visit with a robot that may be anywhere in the room after a step."""
    broken = visit.broken.copy()
    free = PLANAR if broken.shape[-1] == len(PLANAR) else SPATIAL
    broken[step] += np.diag(events.room_variances[free])
    return replace(visit, broken=broken)
