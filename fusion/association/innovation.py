"""The innovation of a sighting: how far it is from where everything else predicts it."""

from dataclasses import dataclass

import numpy as np

from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out

from .events import Events

_REAL = np.float64
_JUDGED = Kernel(
    "tp_judged",
    In(_REAL, ("n", "k", 12)),
    In(_REAL, ("n", "k", 2)),
    In(_REAL, ("n", "k", "c")),
    In(np.int64, ("n", "q")),
    In(_REAL, ("u",)),
    float,
    In(_REAL, ("u", "u")),
    In(np.int64, ("v", 3)),
    In(np.bool_, ("v",)),
    In(_REAL, ("j", 6)),
    float,
    In(_REAL, (6,)),
    float,
    Out(np.bool_, ("n", "k")),
    Out(_REAL, ("v", 2)),
    Out(np.bool_, ("v",)),
)
_NO_JITTER = np.empty((0, 6))


@dataclass(frozen=True, slots=True)
class Linearised:
    """The corners of pictures (n), K of each, about a state.

    `by_base` (n, K, 2, 6): derivatives of the `residual` (n, K, 2), in sigmas, by the robot's pose
    in each picture, `jacobian` (n, K, 2, q) by the unknowns in `rows` (n, q), of which `covariance`
    (u, u) is that of all and `step` (u,) what is left of the way to their minimum; `jitter`
    (n, 6): the variances of the robot's deviation in each picture, None where it has none.
    """

    by_base: Array
    residual: Array
    jacobian: Array
    rows: np.ndarray
    step: Array
    covariance: Array
    jitter: Array | None


def judged(
    seen: Linearised,
    views: np.ndarray,
    is_wrong: np.ndarray,
    events: Events,
    *,
    way: float,
    rest: float,
) -> tuple[Array, np.ndarray]:
    """Return by how much each view is less probable than a wrong one, given everything else (v,):
    νᵀS⁻¹ν + ln|S| of the pose that it shows by itself, with ln|S| at most that of a board that may
    be anywhere, over the score of a wrong one (`Events.excess`); and which corners (n, K) are wild
    about the pose that their own view shows.

    `views` (v, 3): each view's picture, its first corner and that past its last; `is_wrong` (v,):
    those that the state was estimated without; `way`: the share of the step that counts; `rest`:
    the χ² by which the state may still be off its minimum; where a sighting determines something
    nearly alone, that must not count as a contradiction.

    The covariance Σ of the unknowns includes the sighting itself if it is used. Then, with P the
    pose's own covariance and H its derivative by the unknowns, the residual has the covariance
    R = P - HΣHᵀ = P S⁻¹ P, and the innovation ν is S P⁻¹ times the residual. Where the robot
    deviates from its node, the views of one picture constrain each other through the deviation.
    """
    shape = seen.residual.shape[:2]
    wild, found = np.empty(shape, dtype=bool), np.empty((len(views), 2))
    is_determined = np.empty(len(views), dtype=bool)
    _JUDGED(
        np.ascontiguousarray(seen.by_base).reshape(*shape, 12),
        np.ascontiguousarray(seen.residual),
        np.ascontiguousarray(seen.jacobian).reshape(*shape, -1),
        *(seen.rows, seen.step, float(way), np.ascontiguousarray(seen.covariance)),
        *(views, is_wrong),
        _NO_JITTER if seen.jitter is None else np.ascontiguousarray(seen.jitter),
        *(float(events.wild_score), events.room_variances, float(rest)),
        *(wild, found, is_determined),
    )
    # What determines no pose cannot contradict anything.
    excess = np.asarray(events.excess(found[:, 0], found[:, 1]))
    return np.where(is_determined, excess, -events.wrong_limit), wild
