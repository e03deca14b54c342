"""Where a map puts the robot: the current estimate, and the corrections behind it.

A new correction must pass two tests. Does it fit the current estimate, which is every earlier
correction carried forward by odometry? And does it fit each of some earlier corrections, carried
forward by odometry alone? The second test finds what the first cannot: steps that are each small
but sum up to more than odometry can have drifted (a pull). Those earlier corrections are kept at
ages that double, so that the young ones reveal a fast pull and the old ones a slow one.

A correction is fused by covariance intersection (Julier and Uhlmann 1997; with Niehsen's weights of
2002, made free of units): fusion's corrections are correlated through its map, its odometry and its
earlier sightings, by an unknown amount, and this rule stays consistent whatever the amount is. See
decisions/0304-corrections-are-fused-and-watched.md.
"""

import math

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.robot.odometry.odometry import Stamped
from trigpoint.robot.odometry.recent import OdometryHistory
from trigpoint.robot.odometry.reckoning import carried, pose_covariances, started
from trigpoint.site.config import RobotConfig

from .sent_covariance import as_sent

# χ² that a true correction exceeds once in 100 000, by degrees of freedom (planar, in space).
JUMP_CHI2 = {3: 25.90, 6: 33.11}
# Up to eight earlier corrections are tested each time: once in ten million each.
PULL_CHI2 = {3: 35.41, 6: 43.34}
# The age of the oldest correction kept. In that time a pull of 1 cm/s moves a robot 1.3 m, and the
# default odometry noise moves one at 0.4 m/s by some 0.7 m: a slower pull is lost in the noise.
MEMORY_S = 128.0
_FOLLOW_NS = to_ns(0.25)
_PLANAR_ROWS = [0, 1, 5]


class Measured(Struct, frozen=True):
    """A correction at its moment; `covariance`: (6, 6), as sent."""

    at: Stamped
    map_from_base: Pose
    covariance: Array


class Contradiction(Struct, frozen=True):
    """Why a correction does not fit; `is_pull`: by the sum of earlier steps, not by its own."""

    text: str
    is_pull: bool


class _Look(Struct, frozen=True):
    """A correction compared with the n rows, all carried forward to its moment: their poses and
    `covariances` (n, 8, 8); for the k (3 or 6) checked coordinates, `shown` (n, k, k) of these,
    `theirs` (k, k) of the correction, and the `differences` (n, k) to it."""

    at: Stamped
    expected: Pose
    covariances: Array
    shown: Array
    theirs: Array
    differences: Array

    @property
    def chi2(self) -> Array:
        """(n,)"""
        scaled = np.linalg.solve(self.shown + self.theirs, self.differences[..., None])[..., 0]
        return np.sum(self.differences * scaled, axis=-1)


class Placement:
    """Row 0 is the current estimate, the others are the kept corrections, oldest first. All are
    expressed in the odometry frame and carried forward together."""

    def __init__(self, first: Measured, config: RobotConfig) -> None:
        self._config = config
        self._rows = _PLANAR_ROWS if config.planar else list(range(6))
        self._square = (..., *np.ix_(self._rows, self._rows))
        self._at = first.at
        frame = _map_from_odom(first.map_from_base, first.at)
        self._frames, self._stamps = [frame, frame], [first.at.stamp_ns] * 2
        self._covariances = np.stack([self._start(first)] * 2)
        self._looked: tuple[Measured, _Look] | None = None

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest correction included."""
        return self._stamps[0]

    @property
    def map_from_odom(self) -> Pose:
        """Estimated pose of the odometry frame in the map."""
        return self._frames[0]

    def follow(self, history: OdometryHistory, horizon_ns: int) -> None:
        """Carry everything forward to a moment before which no correction can still arrive."""
        if horizon_ns - self._at.stamp_ns < _FOLLOW_NS:
            return
        at = history.at(horizon_ns)
        if at is not None:
            self._covariances = carried(self._covariances, history.steps(self._at, at))
            self._at = at

    def believed(self, history: OdometryHistory, at: Stamped) -> tuple[Pose, Array]:
        """map_from_base and its (6, 6) at a moment after the newest correction."""
        covariance = carried(self._covariances[0], history.steps(self._at, at))
        pose = self._frames[0] @ at.odom_from_base
        return pose, pose_covariances(pose, covariance)

    def contradiction(self, measured: Measured, history: OdometryHistory) -> Contradiction | None:
        """How a correction contradicts what is known, or None."""
        look = self._look(measured, history)
        chi2 = look.chi2
        return self._jump(look.differences[0], chi2[0]) or self._pull(look, chi2)

    def take(self, measured: Measured, history: OdometryHistory) -> tuple[Pose, Array]:
        """Fuse a correction; return the new estimate's pose and covariance (6, 6)."""
        look = self._look(measured, history)
        self._at, self._covariances = look.at, look.covariances
        pose, covariance = self._fused(look)
        self._replace(0, Measured(measured.at, pose, covariance))
        self._remember(measured)
        return pose, covariance

    def _look(self, measured: Measured, history: OdometryHistory) -> _Look:
        """Computed once for a correction that is judged and then taken."""
        if self._looked is not None and self._looked[0] is measured:
            return self._looked[1]
        at = measured.at
        covariances = carried(self._covariances, history.steps(self._at, at))
        expected = Pose.stack(self._frames) @ at.odom_from_base
        look = _Look(
            at,
            expected,
            covariances,
            self._shown(pose_covariances(expected, covariances)),
            self._shown(measured.covariance),
            measured.map_from_base.difference(expected)[:, self._rows],
        )
        self._looked = (measured, look)
        return look

    # ---- contradictions

    def _jump(self, difference: Array, chi2: float) -> Contradiction | None:
        limits = self._config.safety
        far, turned = self._sizes(difference)
        text = ""
        if far > limits.max_jump:
            text = f"it jumps by {far:.2f} m; the limit is {limits.max_jump:g} m"
        elif turned > limits.max_turn:
            text = f"it turns by {turned:.2f} rad; the limit is {limits.max_turn:g} rad"
        elif not chi2 <= JUMP_CHI2[len(self._rows)]:
            text = f"it jumps by {far:.3f} m and {turned:.3f} rad, {math.sqrt(chi2):.1f} sigmas"
        return Contradiction(text, is_pull=False) if text else None

    def _pull(self, look: _Look, chi2: Array) -> Contradiction | None:
        is_pulled = ~(chi2 <= PULL_CHI2[len(self._rows)])  # also true for NaN
        is_pulled[0] = False
        if not np.any(is_pulled):
            return None
        row = int(np.argmax(is_pulled))
        far, turned = self._sizes(look.differences[row])
        age_s = to_seconds(look.at.stamp_ns - self._stamps[row])
        text = (
            f"corrections moved the robot by {far:.2f} m and {turned:.2f} rad in {age_s:.1f} s "
            f"beside its odometry, {math.sqrt(chi2[row]):.1f} sigmas: either they are wrong, or "
            "the odometry is worse than the site file says"
        )
        return Contradiction(text, is_pull=True)

    def _sizes(self, difference: Array) -> tuple[float, float]:
        places = len(self._rows) // 2 + len(self._rows) % 2
        far = float(np.linalg.norm(difference[:places]))
        return far, float(np.linalg.norm(difference[places:]))

    # ---- fusing

    def _fused(self, look: _Look) -> tuple[Pose, Array]:
        """Covariance intersection of the current estimate and a correction."""
        ours, theirs = look.shown[0], look.theirs
        # The correction's share of the total uncertainty is the weight of the current estimate.
        weight = float(np.trace(np.linalg.solve(ours + theirs, theirs))) / len(self._rows)
        gain = (1 - weight) * np.linalg.inv(theirs)
        shown = np.linalg.inv(weight * np.linalg.inv(ours) + gain)
        disturbance, covariance = np.zeros(6), np.zeros((6, 6))
        disturbance[self._rows] = shown @ gain @ look.differences[0]
        covariance[self._square] = as_sent(0.5 * (shown + shown.T))
        return look.expected[0].disturbed(disturbance), covariance

    def _replace(self, row: int, measured: Measured) -> None:
        self._frames[row] = _map_from_odom(measured.map_from_base, measured.at)
        self._stamps[row] = measured.at.stamp_ns
        self._covariances[row] = self._start(measured)

    def _remember(self, measured: Measured) -> None:
        """Append a correction; of each age span (0 to 1 s, to 2, to 4, …) keep the oldest."""
        self._frames.append(_map_from_odom(measured.map_from_base, measured.at))
        self._stamps.append(measured.at.stamp_ns)
        kept, spans = [0], set[int]()
        for row in range(1, len(self._stamps)):
            age_s = to_seconds(measured.at.stamp_ns - self._stamps[row])
            span = math.frexp(age_s)[1] if age_s >= 1.0 else 0
            if age_s < MEMORY_S and span not in spans:
                spans.add(span)
                kept.append(row)
        covariances = [*self._covariances, self._start(measured)]
        self._frames = [self._frames[row] for row in kept]
        self._stamps = [self._stamps[row] for row in kept]
        self._covariances = np.stack([covariances[row] for row in kept])

    def _start(self, measured: Measured) -> Array:
        return started(measured.map_from_base, measured.covariance, self._config.odometry)

    def _shown(self, covariance: Array) -> Array:
        return covariance[self._square]


def _map_from_odom(map_from_base: Pose, at: Stamped) -> Pose:
    return map_from_base @ at.odom_from_base.inverse()
