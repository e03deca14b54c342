"""Which corrections reach the robot. Pure: no bus, no port, no clock.

A robot acts on a correction: a wrong one can drive it into a wall, a missing one only lets it drift
as its odometry does. So whatever is doubtful is refused and counted by its reason. The reasoning
behind the limits is in decisions/0302-which-corrections-reach-a-robot.md.
"""

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from uuid import UUID

import numpy as np

from trigpoint.clock import to_ns, to_seconds
from trigpoint.config import RobotConfig
from trigpoint.correction import CorrectionMark
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric
from trigpoint.messages import PoseEstimate

from .odometry import OdometryHistory, Stamped
from .reckoning import Belief, Reckoning, anchored

MAP_FRAME = "map"
# A correction of this many sigmas comes once in 70 000 by chance (χ² with 3 degrees of freedom).
JUMP_SIGMAS = 5.0
# How far a stamp may lie ahead of our clock: two machines that NTP keeps are nearer.
FUTURE_NS = to_ns(0.05)
# A robot that was carried: as many refused corrections in a row that agree with each other, over at
# least this time, are believed.
AGREEING = 10
AGREEING_NS = to_ns(1.0)
_PLANAR_ROWS = [0, 1, 5]
# 1 mm, and 1.4 mrad: what a planar estimator's rounding never reaches.
_LIFT, _TILT = 1e-3, 1e-6


class Refusal(StrEnum):
    """Why a correction was not handed on."""

    FRAME = "wrong_frame"
    POSE = "not_planar"
    COVARIANCE = "no_covariance"
    UNCERTAIN = "too_uncertain"
    OLD = "too_old"
    FUTURE = "in_the_future"
    ORDER = "out_of_order"
    REPLACED_MAP = "replaced_map"
    NO_ODOMETRY = "no_odometry"
    JUMP = "jump"


@dataclass(frozen=True, slots=True)
class Approved:
    """Hand it on. `firmware_ns`: its moment on the firmware's clock; `establishes`: the pose may be
    anywhere, `why` says the reason, "" otherwise."""

    firmware_ns: int
    establishes: bool
    why: str = ""


@dataclass(frozen=True, slots=True)
class Refused:
    """Do not hand it on; `text` is one line for a person."""

    reason: Refusal
    text: str


@dataclass(frozen=True, slots=True)
class _Run:
    """Refused corrections in a row that agree with each other."""

    map_id: UUID
    since_ns: int
    count: int
    reckoning: Reckoning


class SafetyGate:
    """Judges one robot's corrections in the order in which they come. Not thread-safe."""

    def __init__(self, config: RobotConfig) -> None:
        self._limits, self._noise, self._planar = config.safety, config.odometry, config.planar
        self._span_s = config.safety.max_age + 2.0
        self._history = OdometryHistory(self._span_s)
        self._map_id: UUID | None = None
        self._replaced: deque[UUID] = deque(maxlen=64)
        self._last_sequence = -1
        self._newest_ns = 0
        self._accepted: Reckoning | None = None
        self._run: _Run | None = None

    def add_odometry(self, entry: Stamped) -> None:
        """Every odometry message, as it is published."""
        self._history.add(entry)
        horizon_ns = entry.stamp_ns - to_ns(self._span_s)
        for reckoning in (self._accepted, self._run.reckoning if self._run else None):
            if reckoning is not None:
                reckoning.add(entry)
                reckoning.forget(horizon_ns)

    def restart(self) -> None:
        """The firmware was restarted: the robot knows no pose now; nor do we know how it moved."""
        self._history.clear()
        self._accepted = self._run = None

    def judge(
        self, correction: PoseEstimate, mark: CorrectionMark, now_ns: int
    ) -> Approved | Refused:
        """Whether to hand a correction on; `now_ns`: Unix time on the odometry stamps' clock."""
        refused = (
            self._content(correction)
            or self._age(correction.stamp_ns, now_ns)
            or self._order(correction.stamp_ns, mark)
        )
        if refused:
            return refused
        at = self._history.at(correction.stamp_ns)
        if at is None:
            return Refused(Refusal.NO_ODOMETRY, "there is no odometry about its moment")
        belief = anchored(at, correction.pose, correction.covariance, self._noise)
        return self._place(belief, mark)

    # ---- the correction by itself

    def _content(self, correction: PoseEstimate) -> Refused | None:
        if correction.frame_id != MAP_FRAME:
            text = f"it is given in frame «{correction.frame_id}», not in «{MAP_FRAME}»"
            return Refused(Refusal.FRAME, text)
        if self._planar and not _is_planar(correction.pose):
            return Refused(Refusal.POSE, "it lifts or tilts a robot that drives on a plane")
        shown = self._shown(correction.covariance)
        if not np.all(np.isfinite(shown)) or np.linalg.eigvalsh(symmetric(shown))[0] <= 0:
            return Refused(Refusal.COVARIANCE, "its covariance is not positive")
        return self._uncertainty(correction.covariance)

    def _uncertainty(self, covariance: Array) -> Refused | None:
        place = _largest_sigma(covariance[:2, :2] if self._planar else covariance[:3, :3])
        turn = _largest_sigma(covariance[5:, 5:] if self._planar else covariance[3:, 3:])
        if place > self._limits.max_sigma:
            limit = self._limits.max_sigma
            return Refused(Refusal.UNCERTAIN, f"its sigma of {place:.3f} m is above {limit} m")
        if turn > self._limits.max_heading_sigma:
            limit = self._limits.max_heading_sigma
            return Refused(Refusal.UNCERTAIN, f"its sigma of {turn:.3f} rad is above {limit} rad")
        return None

    def _age(self, stamp_ns: int, now_ns: int) -> Refused | None:
        age_s = to_seconds(now_ns - stamp_ns)
        if age_s > self._limits.max_age:
            limit = self._limits.max_age
            return Refused(Refusal.OLD, f"it is {age_s:.2f} s old; the limit is {limit} s")
        if stamp_ns > now_ns + FUTURE_NS:
            return Refused(Refusal.FUTURE, f"it is stamped {-age_s:.2f} s in the future")
        return None

    def _order(self, stamp_ns: int, mark: CorrectionMark) -> Refused | None:
        """A number that is not above the last is refused, unless the stamp is newer than all: a
        restarted fusion may number anew, but what it says is of now."""
        if mark.map_id != self._map_id:
            return None
        if mark.sequence <= self._last_sequence and stamp_ns <= self._newest_ns:
            last = self._last_sequence
            return Refused(Refusal.ORDER, f"its number {mark.sequence} comes after {last}")
        self._last_sequence = mark.sequence
        self._newest_ns = max(self._newest_ns, stamp_ns)
        return None

    # ---- the correction beside what is known

    def _place(self, belief: Belief, mark: CorrectionMark) -> Approved | Refused:
        if mark.map_id in self._replaced:
            text = f"it is of the map {mark.map_id}, which another one has replaced"
            return self._doubt(belief, mark, Refused(Refusal.REPLACED_MAP, text))
        if mark.map_id != self._map_id:
            return self._establish(belief, mark, "first of a map")
        if self._accepted is None:
            return self._establish(belief, mark, "first after a restart of the firmware")
        if jump := self._jump(belief, self._accepted):
            return self._doubt(belief, mark, Refused(Refusal.JUMP, jump))
        self._accept(belief)
        return Approved(belief.at.firmware_ns, establishes=False)

    def _jump(self, belief: Belief, known: Reckoning) -> str:
        """What is wrong with a pose beside what odometry allows since the known one, or ""."""
        expected = known.at(belief.at)
        difference = self._shown(belief.map_from_base.difference(expected.map_from_base))
        places = 2 if self._planar else 3
        far = float(np.linalg.norm(difference[:places]))
        turned = float(np.linalg.norm(difference[places:]))
        if far > self._limits.max_jump:
            return f"it jumps by {far:.2f} m; the limit is {self._limits.max_jump} m"
        if turned > self._limits.max_turn:
            return f"it turns by {turned:.2f} rad; the limit is {self._limits.max_turn} rad"
        allowed = self._shown(expected.pose_covariance + belief.pose_covariance)
        sigmas = float(np.sqrt(difference @ np.linalg.solve(allowed, difference)))
        if sigmas > JUMP_SIGMAS:
            return f"it jumps by {far:.3f} m and {turned:.3f} rad, {sigmas:.1f} sigmas"
        return ""

    def _doubt(self, belief: Belief, mark: CorrectionMark, refused: Refused) -> Approved | Refused:
        """Refuse, unless the corrections before it were refused too and agree with it."""
        run = self._run
        if run is None or run.map_id != mark.map_id or self._jump(belief, run.reckoning):
            since_ns, count = belief.at.stamp_ns, 1
        else:
            since_ns, count = run.since_ns, run.count + 1
        if count >= AGREEING and belief.at.stamp_ns - since_ns >= AGREEING_NS:
            return self._establish(belief, mark, f"{count} in a row agree")
        self._run = _Run(mark.map_id, since_ns, count, self._reckoning(belief))
        return refused

    def _establish(self, belief: Belief, mark: CorrectionMark, why: str) -> Approved:
        if mark.map_id != self._map_id:
            if self._map_id is not None:
                self._replaced.append(self._map_id)
            if mark.map_id in self._replaced:
                self._replaced.remove(mark.map_id)
            self._map_id = mark.map_id
            self._last_sequence, self._newest_ns = mark.sequence, belief.at.stamp_ns
        self._accept(belief)
        return Approved(belief.at.firmware_ns, establishes=True, why=why)

    def _accept(self, belief: Belief) -> None:
        self._accepted, self._run = self._reckoning(belief), None

    def _reckoning(self, belief: Belief) -> Reckoning:
        return Reckoning(belief, self._history, self._noise)

    def _shown(self, values: Array) -> Array:
        """The rows (and columns) that are checked: x, y and heading of a planar robot."""
        if not self._planar:
            return values
        return values[np.ix_(*[_PLANAR_ROWS] * values.ndim)]


def _is_planar(pose: Pose) -> bool:
    return abs(pose.rotation[2, 2] - 1) < _TILT and abs(pose.translation[2]) < _LIFT


def _largest_sigma(covariance: Array) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
