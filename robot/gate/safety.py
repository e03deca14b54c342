"""Decides which corrections reach the robot, and in what form. Pure: no bus, no port, no clock.

A robot acts on a correction: a wrong one can drive it into a wall, a missing one only lets it drift
as its odometry does. So every doubtful correction is refused, and counted by reason. The reasoning
behind the limits is in decisions/0302-which-corrections-reach-a-robot.md and 0304.
"""

from enum import StrEnum
from uuid import UUID

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.contract.correction import CorrectionMark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.robot.odometry.odometry import Stamped
from trigpoint.robot.odometry.recent import OdometryHistory
from trigpoint.site.config import RobotConfig

from .consistency import Agreement, MapWord
from .map_placement import Measured, Placement
from .sent_covariance import as_sent, covariance_fault

MAP_FRAME = "map"
# How far a stamp may be ahead of our clock: two machines kept by NTP differ by less.
FUTURE_NS = to_ns(0.05)
# Two senders within this time are active at once; a killed fusion takes longer to restart.
SENDERS_NS = to_ns(2.0)
# A site is a building; anything further away is a corrupt number.
FURTHEST_M = 100e3
_CHECKED = {True: np.ix_([0, 1, 5], [0, 1, 5]), False: np.ix_(range(6), range(6))}
# 1 mm, and 1.4 mrad: far above a planar estimator's rounding.
_LIFT, _TILT = 1e-3, 1e-6


class Refusal(StrEnum):
    """Why a correction was not passed to the robot."""

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


class Approved(Struct, frozen=True):
    """Pass this on. `firmware_ns`: its time by the firmware's clock; `map_from_base`, `covariance`
    (6, 6): the estimate after fusing this correction; `establishes`: the pose may be anywhere, for
    the reason `why`, "" otherwise."""

    at: Stamped
    map_from_base: Pose
    covariance: Array
    establishes: bool
    why: str = ""

    @property
    def firmware_ns(self) -> int:
        return self.at.firmware_ns


class Refused(Struct, frozen=True):
    """Do not pass it on; `text` is one line for a person."""

    reason: Refusal
    text: str


class SafetyGate:
    """Judges one robot's corrections in order of arrival. Not thread-safe."""

    def __init__(self, config: RobotConfig) -> None:
        self._config, self._limits, self._planar = config, config.safety, config.planar
        # The horizon is older than every correction that may still arrive, with room for the
        # readings that interpolation needs.
        self._horizon_ns = to_ns(config.safety.max_age + 0.5)
        self.history = OdometryHistory(config.safety.max_age + 2.0, config.odometry)
        self._map_id: UUID | None = None
        self._placement: Placement | None = None
        self._run: Agreement | None = None
        self._word = MapWord()
        self._senders: dict[str, int] = {}

    # ---- inputs other than corrections

    def add_odometry(self, entry: Stamped) -> None:
        """Take in every odometry message, as published."""
        self.history.add(entry)
        for placement in (self._placement, self._run.placement if self._run else None):
            if placement is not None:
                placement.follow(self.history, entry.stamp_ns - self._horizon_ns)

    def restart(self) -> None:
        """The firmware restarted: the robot has no pose now, and its motion is unknown."""
        self.history.clear()
        self._placement = self._run = None

    def hear(self, maps: list[UUID], now_ns: int) -> None:
        """Take in the answers of the nodes that serve `fusion/map`."""
        self._word.hear(maps, now_ns)

    @property
    def asks(self) -> bool:
        """Whether fusion's confirmation is needed: corrections want to place the robot anew."""
        return self._run is not None and not self._word.speaks_for(self._run)

    @property
    def is_placed(self) -> bool:
        """Whether the robot's pose is known."""
        return self._placement is not None

    @property
    def state(self) -> str:
        """Whether the robot's pose is known, in words for people."""
        if self._run is None:
            return "known" if self._placement else "unknown: no correction came yet"
        sure = "doubted" if self._placement else "unknown"
        return f"{sure}: {self._run.progress(self._word)}"

    def believed(self) -> tuple[Stamped, Pose, Array] | None:
        """The newest reading, the pose there and its (6, 6) covariance; None if unknown."""
        last = self.history.last
        if self._placement is None or last is None or last.stamp_ns < self._placement.newest_ns:
            return None
        return (last, *self._placement.believed(self.history, last))

    # ---- judging

    def judge(
        self, correction: PoseEstimate, mark: CorrectionMark, now_ns: int, sender: str = ""
    ) -> Approved | Refused:
        """Judge a correction; `now_ns`: Unix time on the odometry stamps' clock."""
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
        """Refuse a correction stamped no later than the last applied one: it says nothing new. Its
        number may be lower: a restarted fusion counts anew, but its corrections are current."""
        if self._placement is not None and stamp_ns <= self._placement.newest_ns:
            return Refused(Refusal.ORDER, f"number {mark.sequence} is no newer than one applied")
        if self._run is not None and stamp_ns <= self._run.placement.newest_ns:
            return Refused(Refusal.ORDER, f"number {mark.sequence} is no newer than one before it")
        return None

    # ---- the correction compared with what is known

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
        """Refuse, unless a complete run of corrections agrees and fusion confirms its map."""
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
        """The (6, 6) sent to the robot: zero but for the rows and columns that are checked."""
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
