"""Which corrections reach the robot, and what of them. Pure: no bus, no port, no clock.

A robot acts on a correction: a wrong one can drive it into a wall, a missing one only lets it drift
as its odometry does. So whatever is doubtful is refused and counted by its reason. The reasoning
behind the limits is in decisions/0302-which-corrections-reach-a-robot.md and 0304.
"""

from dataclasses import dataclass
from enum import StrEnum
from uuid import UUID

import numpy as np

from trigpoint.clock import to_ns, to_seconds
from trigpoint.config import RobotConfig
from trigpoint.correction import CorrectionMark
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.messages import PoseEstimate

from .agreement import Agreement, MapWord
from .history import OdometryHistory
from .odometry import Stamped
from .placement import Measured, Placement
from .sent_covariance import as_sent, covariance_fault

MAP_FRAME = "map"
# How far a stamp may lie ahead of our clock: two machines that NTP keeps are nearer.
FUTURE_NS = to_ns(0.05)
# Two that speak within this time speak at once; a killed fusion that is started again takes longer.
SENDERS_NS = to_ns(2.0)
# A site is a building; what lies further away is a broken number.
FURTHEST_M = 100e3
_CHECKED = {True: np.ix_([0, 1, 5], [0, 1, 5]), False: np.ix_(range(6), range(6))}
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
    SENDERS = "two_senders"
    ORDER = "out_of_order"
    NO_ODOMETRY = "no_odometry"
    JUMP = "jump"
    PULL = "pull"
    OTHER_MAP = "other_map"
    WAITING = "waiting"


@dataclass(frozen=True, slots=True)
class Approved:
    """Hand this on. `firmware_ns`: its moment on the firmware's clock; `map_from_base` and
    `covariance` (6, 6): what is believed with this correction fused; `establishes`: the pose may be
    anywhere, `why` says the reason, "" otherwise."""

    at: Stamped
    map_from_base: Pose
    covariance: Array
    establishes: bool
    why: str = ""

    @property
    def firmware_ns(self) -> int:
        return self.at.firmware_ns


@dataclass(frozen=True, slots=True)
class Refused:
    """Do not hand it on; `text` is one line for a person."""

    reason: Refusal
    text: str


class SafetyGate:
    """Judges one robot's corrections in the order in which they come. Not thread-safe."""

    def __init__(self, config: RobotConfig) -> None:
        self._config, self._limits, self._planar = config, config.safety, config.planar
        # The horizon lies behind every correction that may still come, with room for the
        # interpolation's neighbours.
        self._horizon_ns = to_ns(config.safety.max_age + 0.5)
        self.history = OdometryHistory(config.safety.max_age + 2.0, config.odometry)
        self._map_id: UUID | None = None
        self._placement: Placement | None = None
        self._run: Agreement | None = None
        self._word = MapWord()
        self._senders: dict[str, int] = {}

    # ---- what comes beside corrections

    def add_odometry(self, entry: Stamped) -> None:
        """Every odometry message, as it is published."""
        self.history.add(entry)
        for placement in (self._placement, self._run.placement if self._run else None):
            if placement is not None:
                placement.follow(self.history, entry.stamp_ns - self._horizon_ns)

    def restart(self) -> None:
        """The firmware was restarted: the robot knows no pose now; nor do we know how it moved."""
        self.history.clear()
        self._placement = self._run = None

    def hear(self, maps: list[UUID], now_ns: int) -> None:
        """What those who serve `fusion/map` answered when they were asked."""
        self._word.hear(maps, now_ns)

    @property
    def asks(self) -> bool:
        """Whether fusion's own word is needed: corrections want to place the robot anew."""
        return self._run is not None and not self._word.speaks_for(self._run)

    @property
    def is_placed(self) -> bool:
        """Whether it is known where the robot is."""
        return self._placement is not None

    @property
    def state(self) -> str:
        """How it stands with the robot's place, for people."""
        if self._run is None:
            return "known" if self._placement else "unknown: no correction came yet"
        sure = "doubted" if self._placement else "unknown"
        return f"{sure}: {self._run.progress(self._word)}"

    def believed(self) -> tuple[Stamped, Pose, Array] | None:
        """Where the robot is at the newest reading, and its (6, 6); None where that is unknown."""
        last = self.history.last
        if self._placement is None or last is None or last.stamp_ns < self._placement.newest_ns:
            return None
        return (last, *self._placement.believed(self.history, last))

    # ---- judging

    def judge(
        self, correction: PoseEstimate, mark: CorrectionMark, now_ns: int, sender: str = ""
    ) -> Approved | Refused:
        """Whether to hand a correction on; `now_ns`: Unix time on the odometry stamps' clock."""
        refused = (
            self._content(correction)
            or self._age(correction.stamp_ns, now_ns)
            or self._sender(sender, now_ns)
            or self._order(correction.stamp_ns, mark)
        )
        if refused:
            return refused
        at = self.history.at(correction.stamp_ns)
        if at is None:
            return Refused(Refusal.NO_ODOMETRY, "there is no odometry about its moment")
        measured = Measured(at, correction.pose, self._sent(correction.covariance))
        return self._place(measured, mark, now_ns)

    # ---- the correction by itself

    def _content(self, correction: PoseEstimate) -> Refused | None:
        if correction.frame_id != MAP_FRAME:
            text = f"it is given in frame «{correction.frame_id}», not in «{MAP_FRAME}»"
            return Refused(Refusal.FRAME, text)
        if not np.max(np.abs(correction.pose.translation)) < FURTHEST_M:
            return Refused(Refusal.POSE, f"it lies over {FURTHEST_M / 1e3:.0f} km away")
        if self._planar and not _is_planar(correction.pose):
            return Refused(Refusal.POSE, "it lifts or tilts a robot that drives on a plane")
        if fault := covariance_fault(self._shown(correction.covariance)):
            return Refused(Refusal.COVARIANCE, fault)
        return self._uncertainty(self._sent(correction.covariance))

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

    def _sender(self, sender: str, now_ns: int) -> Refused | None:
        self._senders = {
            name: last_ns
            for name, last_ns in self._senders.items()
            if abs(now_ns - last_ns) <= SENDERS_NS
        } | {sender: now_ns}
        if len(self._senders) < 2:
            return None
        names = " and ".join(f"«{name or 'unknown'}»" for name in sorted(self._senders)[:3])
        text = f"sessions {names} both send corrections for this robot; stop one of the two"
        return Refused(Refusal.SENDERS, text)

    def _order(self, stamp_ns: int, mark: CorrectionMark) -> Refused | None:
        """A correction of a moment that is not after the last applied one's says nothing new. Its
        number may be lower: a restarted fusion counts anew, but what it says is of now."""
        if self._placement is not None and stamp_ns <= self._placement.newest_ns:
            return Refused(Refusal.ORDER, f"number {mark.sequence} is no newer than one applied")
        if self._run is not None and stamp_ns <= self._run.placement.newest_ns:
            return Refused(Refusal.ORDER, f"number {mark.sequence} is no newer than one before it")
        return None

    # ---- the correction beside what is known

    def _place(self, measured: Measured, mark: CorrectionMark, now_ns: int) -> Approved | Refused:
        if self._placement is None:
            waiting = Refused(Refusal.WAITING, "it is not known yet where the robot is")
            return self._doubt(measured, mark.map_id, now_ns, waiting)
        if mark.map_id != self._map_id:
            text = f"it is of the map {mark.map_id}, not of the one that the robot knows"
            return self._doubt(measured, mark.map_id, now_ns, Refused(Refusal.OTHER_MAP, text))
        if wrong := self._placement.contradiction(measured, self.history):
            reason = Refusal.PULL if wrong.is_pull else Refusal.JUMP
            return self._doubt(measured, mark.map_id, now_ns, Refused(reason, wrong.text))
        self._run = None
        pose, covariance = self._placement.take(measured, self.history)
        return Approved(measured.at, pose, covariance, establishes=False)

    def _doubt(
        self, measured: Measured, map_id: UUID, now_ns: int, refused: Refused
    ) -> Approved | Refused:
        """Refuse, unless a run of corrections agrees with this one and all else does too."""
        run = self._run
        if run is None or not run.goes_on_with(measured, map_id, self.history):
            self._run = Agreement(measured, map_id, now_ns, self._config)
            return refused
        pose, covariance = run.take(measured, self.history)
        if not run.is_complete or not self._word.speaks_for(run):
            return Refused(refused.reason, f"{refused.text}; {run.progress(self._word)}")
        self._map_id, self._placement, self._run = map_id, run.placement, None
        why = f"{run.count} corrections in a row agree, and fusion says that its map is {map_id}"
        return Approved(measured.at, pose, covariance, establishes=True, why=why)

    def _sent(self, covariance: Array) -> Array:
        """(6, 6), of which the robot is told the rows that are checked."""
        sent = np.zeros((6, 6))
        sent[_CHECKED[self._planar]] = as_sent(self._shown(covariance))
        return sent

    def _shown(self, covariance: Array) -> Array:
        """The rows and columns that are checked: x, y and heading of a planar robot."""
        return covariance[_CHECKED[self._planar]]


def _is_planar(pose: Pose) -> bool:
    return abs(pose.rotation[2, 2] - 1) < _TILT and abs(pose.translation[2]) < _LIFT


def _largest_sigma(covariance: Array) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
