"""The bridge's logic between bus and serial line, without either: events in, messages out.

Called by the reader's thread and by the corrections' thread; one lock guards all state.
"""

import logging
import threading
from uuid import UUID

from msgspec import Struct

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.contract.correction import CorrectionMark
from trigpoint.contract.messages import Odometry, PoseEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.node.health import Health
from trigpoint.site.config import RobotConfig

from .gate.blend import Blend
from .gate.safety import Approved, Refusal, Refused, SafetyGate
from .line.firmware_clock import FirmwareClock
from .line.limits import Motion, MotionLimits
from .line.protocol import (
    Acknowledged,
    Advice,
    ClockExchange,
    Connected,
    Damaged,
    Event,
    LocatedPose,
    Mismatched,
    Missing,
    Reading,
    RobotCorrection,
    Silent,
    StampClock,
    Takes,
    Traits,
    Unanswered,
    Vitals,
)
from .odometry.odometry import OdometryStream, Stamped
from .odometry.stamps import Offset, Stamps

_log = logging.getLogger(__name__)


# Problems of the site rather than of one message.
_SERIOUS = {Refusal.SENDERS, Refusal.PULL, Refusal.OTHER_MAP}


class Location(Struct, frozen=True):
    """A robot's pose at a reading. `covariance`: (6, 6), as in the contract; `resets`: how often
    the robot was placed anew."""

    at: Stamped
    map_from_base: Pose
    covariance: Array
    resets: int
    odom_from_counted: Pose

    @property
    def map_from_odom(self) -> Pose:
        """Pose in the map of the odometry frame used on the bus."""
        return self.map_from_base @ self.at.odom_from_base.inverse()

    @property
    def map_from_counted(self) -> Pose:
        """Pose in the map of the robot's own odometry frame, which restarts with its counts."""
        return self.map_from_odom @ self.odom_from_counted

    @property
    def for_robot(self) -> LocatedPose:
        """The same, stamped by the robot's own clock."""
        return LocatedPose(self.at.firmware_ns, self.map_from_base, self.covariance, self.resets)


# Odometry comes at least 20 times a second (docs/reference/serial.md); so long without is a gap.
_GAP_NS = to_ns(0.5)
# How often the pose of a robot that takes no corrections is sent to it and to the bus: navigation
# stacks expect tf at 10 Hz or more, ArduPilot a position at 4 Hz or more.
LOCATE_EVERY_NS = to_ns(0.05)
# Correction numbers start at this many per second since 1970, so that a restarted bridge continues
# above every number that its predecessor can have used. Modulo 2³²: 8.5 years.
NUMBERS_A_SECOND = 16
_NUMBERS = 1 << 32

OUR_SERIAL = Traits(Takes.CORRECTIONS, StampClock.FIRMWARE)


def first_number(unix_ns: int) -> int:
    """The number from which a bridge started now counts its corrections."""
    return unix_ns * NUMBERS_A_SECOND // 10**9 % _NUMBERS


class Bridge:
    """One robot's bridge. `health` counts everything received, sent, lost and refused."""

    def __init__(
        self,
        robot: str,
        config: RobotConfig,
        health: Health,
        offset: Offset,
        traits: Traits = OUR_SERIAL,
        *,
        number: int = 0,
    ) -> None:
        self._robot, self._health = robot, health
        self._traits, self._limits = traits, MotionLimits(config)
        self._blend, self._planar = Blend(config.safety.blend), config.planar
        self._located_ns: int | None = None
        self._resets = 0
        self._lock = threading.Lock()
        self._stamps = Stamps(robot, traits.clock, offset, health)
        self._stream = OdometryStream(robot)
        self._gate = SafetyGate(config)
        self._connected: Connected | None = None
        self._number = number
        self._refused_for = self._refusal = self._complaint = ""
        self._vitals = Vitals(0, 0)

    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._robot

    @property
    def is_planar(self) -> bool:
        """Whether the robot drives on a plane."""
        return self._planar

    @property
    def clock(self) -> FirmwareClock:
        """The firmware's clock, as estimated so far."""
        return self._stamps.clock

    @property
    def odometry_ahead_s(self) -> float:
        """How far a robot's own Unix time was ahead of ours when its newest reading came."""
        return self._stamps.ahead_s

    @property
    def connected(self) -> Connected | None:
        """Who is at the port; None until it identifies itself."""
        return self._connected

    @property
    def complaint(self) -> str:
        """What was wrong with what came since the last good reading; "" if nothing was."""
        return self._complaint

    @property
    def refusal(self) -> str:
        """Why the last correction is not taken, or not yet; "" where it is, or none came."""
        return self._refusal

    @property
    def vitals(self) -> Vitals:
        """The firmware's own counters."""
        return self._vitals

    @property
    def state(self) -> str:
        """Whether the robot's pose is known, in words for people."""
        with self._lock:
            return self._gate.state

    def place(self) -> tuple[Pose, Array] | None:
        """The robot's pose in the map now and its (6, 6) covariance; None if it is unknown."""
        with self._lock:
            believed = self._gate.believed()
            return None if believed is None else believed[1:]

    def unix_ns(self, elapsed_ns: int) -> int:
        """Unix time on the time scale of the odometry's stamps."""
        return self._stamps.unix_ns(elapsed_ns)

    def follow(self, clock: Clock) -> None:
        """Stamp by `clock`, even after it was set: odometry continues, and corrections are no
        longer compared with what was stamped before. Call it once a second."""
        with self._lock:
            moved_ns = self._stamps.follow(clock)
            if moved_ns == 0:
                return
            self._stream.shift(moved_ns)
            self._limits.restart()
            self._gate.restart()
            self._blend.restart()

    def on_event(self, event: Event) -> Odometry | None:
        """Process one event; return the odometry message that results, if any."""
        with self._lock:
            match event:
                case Reading():
                    return self._read(event)
                case ClockExchange():
                    self._stamps.clock.add(event)
                case Connected():
                    self._connect(event)
                case Acknowledged():
                    self._acknowledge(event)
                case Vitals():
                    self._vitals = event
                case _:
                    self._trouble(event)
            return None

    @property
    def asks_for_map(self) -> bool:
        """Whether to ask fusion for its map: corrections want to place the robot anew, and one
        sender's word is not enough."""
        with self._lock:
            return self._gate.asks

    def hear_map(self, maps: list[UUID], elapsed_ns: int) -> None:
        """Take in the answers of the nodes that serve `fusion/map`."""
        with self._lock:
            self._gate.hear(maps, self.unix_ns(elapsed_ns))

    def locate(self) -> Location | None:
        """The robot's pose at its newest reading; None if it is unknown or not yet due for sending.

        The uncertainty grows with the distance since the last correction.
        """
        with self._lock:
            believed = self._gate.believed()
            if believed is None:
                return None
            at, pose, covariance = believed
            if self._located_ns is not None and at.stamp_ns - self._located_ns < LOCATE_EVERY_NS:
                return None
            self._located_ns = at.stamp_ns
            pose, covariance = self._blend.told(at, pose, covariance)
            counted = self._stream.odom_from_counted
            return Location(at, pose, covariance, self._resets, counted)

    def on_correction(
        self,
        correction: PoseEstimate,
        mark: CorrectionMark,
        elapsed_ns: int,
        sender: str = "",
    ) -> RobotCorrection | None:
        """The correction to send to the robot; None if it is refused (and counted)."""
        with self._lock:
            self._health.count("corrections")
            if self._connected is None:
                return self._refuse("not_connected", "the robot is not connected")
            verdict = self._gate.judge(correction, mark, self.unix_ns(elapsed_ns), sender)
            self._health.describe("localisation", self._gate.state)
            if isinstance(verdict, Refused):
                return self._refuse_by(verdict)
            return self._hand_on(mark, verdict)

    def pass_over(self, why: str) -> None:
        """Take note of a correction that is not even judged."""
        with self._lock:
            self._refusal = why

    def _read(self, reading: Reading) -> Odometry | None:
        stamp_ns = self._stamps.of(reading)
        if stamp_ns is None:
            return None
        last = self._stream.last
        if last is not None and stamp_ns <= last.stamp_ns:
            self._health.lose("odometry_out_of_order")
            return None
        if not self._is_possible(stamp_ns, reading):
            return None
        if last is not None and stamp_ns - last.stamp_ns > _GAP_NS:
            self._health.lose("odometry_gaps")
        odometry = self._stream.add(reading, stamp_ns)
        assert odometry is not None  # its stamp was checked above
        assert self._stream.last is not None
        self._gate.add_odometry(self._stream.last)
        self._complaint = ""
        self._health.count("odometry")
        return odometry

    def _is_possible(self, stamp_ns: int, reading: Reading) -> bool:
        """Whether the robot can have moved so; if its count restarted, odometry continues here."""
        motion = self._limits.look(stamp_ns, reading.pose, reading.doubt_ns)
        if motion is Motion.POSSIBLE:
            return True
        if motion is Motion.IMPOSSIBLE:
            self._health.lose("odometry_impossible")
            self._complain(
                f"odometry of robot {self._robot} is refused: it moves further than max_speed or "
                "max_turn in the site file allow"
            )
            return False
        self._health.lose("odometry_epochs")
        self._restart()
        self._health.fail(
            f"the odometry of robot {self._robot} began to count anew; it goes on from where it "
            "was last, and the robot is placed anew"
        )
        return True

    def _restart(self) -> None:
        """The robot's motion is unknown: its odometry continues, its pose is determined anew."""
        self._stream.restart()
        self._gate.restart()
        self._blend.restart()

    def _connect(self, event: Connected) -> None:
        known, self._connected = self._connected, event
        self._health.count("connections")
        if known is None or known.boot == event.boot:
            return
        self._stamps.clock.restart()
        self._limits.restart()
        self._restart()
        self._health.lose("firmware_restarts")
        self._health.fail(
            f"the firmware of robot {self._robot} was restarted; its odometry goes on from where "
            "it was last, and the next correction sets it anew"
        )

    def _acknowledge(self, event: Acknowledged) -> None:
        self._health.observe("correction_answer", to_seconds(event.round_trip_ns))
        if event.is_accepted:
            self._health.count("corrections_accepted")
            self._refusal = ""
        else:
            self._health.lose("corrections_refused_by_robot")
            self._refusal = f"robot {self._robot} refused a correction: {event.reason}"
            self._health.fail(self._refusal)

    def _trouble(self, event: Event) -> None:
        match event:
            case Damaged():
                self._health.lose(f"serial_{event.kind.value}_errors")
                if event.text:
                    self._complain(event.text)
            case Advice():
                _log.warning("%s", event.text)
            case Missing():
                self._health.lose("serial_frames_missing", event.frames)
            case Unanswered():
                self._health.lose("corrections_unanswered")
            case Mismatched():
                self._connected = None
                self._complain(event.text)
            case Silent():
                self._complain(f"robot {self._robot} is silent; is it on, and is `baud` right?")

    def _complain(self, text: str) -> None:
        self._complaint = text
        self._health.fail(text)

    def _refuse_by(self, refused: Refused) -> None:
        if refused.reason is Refusal.WAITING:
            # This is the normal state before the robot is placed; nothing is lost.
            self._health.count("corrections_waiting")
            self._refusal = f"those that come wait; its place is {self._gate.state}"
            return
        if refused.reason in _SERIOUS:
            self._health.fail(f"a correction for robot {self._robot} was refused: {refused.text}")
        self._refuse(refused.reason.value, refused.text)

    def _refuse(self, reason: str, text: str) -> None:
        self._health.lose(f"corrections_refused_{reason}")
        self._refusal = text
        if reason != self._refused_for:  # the first of a run is logged, all are counted
            self._refused_for = reason
            _log.warning("a correction for robot %s was refused: %s", self._robot, text)

    def _hand_on(self, mark: CorrectionMark, approved: Approved) -> RobotCorrection:
        self._number = (self._number + 1) % _NUMBERS
        self._refused_for = self._refusal = ""
        if approved.establishes:
            self._resets += 1
            self._health.count("frames_established")
            _log.info("robot %s is told where it is anew: %s", self._robot, approved.why)
        if self._traits.takes is Takes.CORRECTIONS:
            self._refusal = f"robot {self._robot} has not answered the last"
            pose, covariance = self._blend.told(
                approved.at,
                approved.map_from_base,
                approved.covariance,
                establishes=approved.establishes,
            )
        else:  # the bridge keeps it; blending happens at the readings, when the pose is sent
            self._health.count("corrections_accepted")
            pose, covariance = approved.map_from_base, approved.covariance
            if approved.establishes:
                self._blend.restart()
        return RobotCorrection(
            number=self._number,
            firmware_ns=approved.firmware_ns,
            map_id=mark.map_id,
            sequence=mark.sequence,
            map_from_base=pose,
            covariance=covariance,
            establishes=approved.establishes,
        )
