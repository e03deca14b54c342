"""The bridge's work between bus and serial line, without either: events in, messages out.

The reader's thread and the corrections' thread both come here; one lock guards it all.
"""

import logging
import threading
from dataclasses import dataclass

from trigpoint.config import RobotConfig
from trigpoint.correction import CorrectionMark
from trigpoint.health import Health
from trigpoint.messages import Odometry, PoseEstimate

from .firmware_clock import CONTRADICTION_NS, FirmwareClock
from .odometry import OdometryStream
from .protocol import (
    Acknowledged,
    ClockExchange,
    Connected,
    Damaged,
    Event,
    Mismatched,
    Missing,
    Reading,
    RobotCorrection,
    Silent,
    Unanswered,
    Vitals,
)
from .safety import Approved, Refused, SafetyGate

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Offset:
    """What turns this machine's monotonic clock into Unix time: nanoseconds to add.

    Taken once: the odometry's stamps must not jump when somebody sets the machine's clock.
    """

    unix_minus_elapsed_ns: int


class Bridge:
    """One robot. `health` counts everything that comes, goes, is lost and refused."""

    def __init__(self, robot: str, config: RobotConfig, health: Health, offset: Offset) -> None:
        self._robot, self._health, self._offset = robot, health, offset
        self._lock = threading.Lock()
        self._clock = FirmwareClock()
        self._stream = OdometryStream(robot)
        self._gate = SafetyGate(config)
        self._connected: Connected | None = None
        self._number = 0
        self._refused_for = ""
        self._vitals = Vitals(0, 0)
        self._answer_ms = 0.0

    @property
    def clock(self) -> FirmwareClock:
        """The firmware's clock as known so far."""
        return self._clock

    @property
    def connected(self) -> Connected | None:
        """Who is at the port; None while nobody has said."""
        return self._connected

    @property
    def answer_ms(self) -> float:
        """How long the robot took to acknowledge the last correction, milliseconds."""
        return self._answer_ms

    @property
    def vitals(self) -> Vitals:
        """What the firmware says of itself."""
        return self._vitals

    def unix_ns(self, elapsed_ns: int) -> int:
        """Unix time on the scale of the odometry's stamps."""
        return elapsed_ns + self._offset.unix_minus_elapsed_ns

    def on_event(self, event: Event) -> Odometry | None:
        """Take in one event; returns the odometry message that it leads to."""
        with self._lock:
            match event:
                case Reading():
                    return self._read(event)
                case ClockExchange():
                    self._clock.add(event)
                case Connected():
                    self._connect(event)
                case Acknowledged():
                    self._acknowledge(event)
                case Vitals():
                    self._vitals = event
                case _:
                    self._trouble(event)
            return None

    def on_correction(
        self, correction: PoseEstimate, mark: CorrectionMark, elapsed_ns: int
    ) -> RobotCorrection | None:
        """What to hand to the robot; None where the correction is refused (and counted)."""
        with self._lock:
            self._health.count("corrections")
            if self._connected is None:
                return self._refuse("not_connected", "the robot is not connected")
            verdict = self._gate.judge(correction, mark, self.unix_ns(elapsed_ns))
            if isinstance(verdict, Refused):
                return self._refuse(verdict.reason.value, verdict.text)
            return self._hand_on(correction, mark, verdict)

    def _read(self, reading: Reading) -> Odometry | None:
        machine_ns = self._clock.machine_ns(reading.firmware_ns)
        if machine_ns is None:
            self._health.count("odometry_before_clock")
            return None
        if machine_ns > reading.received_ns + CONTRADICTION_NS:
            # The firmware's clock was set: such a stamp would make all later readings out of order.
            self._health.lose("odometry_ahead_of_clock")
            return None
        odometry = self._stream.add(reading, self.unix_ns(machine_ns))
        if odometry is None or self._stream.last is None:
            self._health.lose("odometry_out_of_order")
            return None
        self._gate.add_odometry(self._stream.last)
        self._health.count("odometry")
        return odometry

    def _connect(self, event: Connected) -> None:
        known, self._connected = self._connected, event
        self._health.count("connections")
        if known is None or known.boot == event.boot:
            return
        self._clock.restart()
        self._stream.restart()
        self._gate.restart()
        self._health.lose("firmware_restarts")
        self._health.fail(
            f"the firmware of robot {self._robot} was restarted; its odometry goes on from where "
            "it was last, and the next correction sets it anew"
        )

    def _acknowledge(self, event: Acknowledged) -> None:
        self._answer_ms = event.round_trip_ns / 1e6
        if event.is_accepted:
            self._health.count("corrections_accepted")
        else:
            self._health.lose("corrections_refused_by_robot")
            self._health.fail(f"robot {self._robot} refused a correction: {event.reason}")

    def _trouble(self, event: Event) -> None:
        match event:
            case Damaged():
                self._health.lose(f"serial_{event.kind.value}_errors")
            case Missing():
                self._health.lose("serial_frames_missing", event.frames)
            case Unanswered():
                self._health.lose("corrections_unanswered")
            case Mismatched():
                self._connected = None
                self._health.fail(event.text)
            case Silent():
                self._health.fail(f"robot {self._robot} is silent; is it on, and is `baud` right?")

    def _refuse(self, reason: str, text: str) -> None:
        self._health.lose(f"corrections_refused_{reason}")
        if reason != self._refused_for:  # the first of a run is told, all are counted
            self._refused_for = reason
            _log.warning("a correction for robot %s was refused: %s", self._robot, text)

    def _hand_on(
        self, correction: PoseEstimate, mark: CorrectionMark, approved: Approved
    ) -> RobotCorrection:
        self._number += 1
        self._refused_for = ""
        if approved.establishes:
            self._health.count("frames_established")
            _log.info("robot %s is told where it is anew: %s", self._robot, approved.why)
        return RobotCorrection(
            number=self._number,
            firmware_ns=approved.firmware_ns,
            map_id=mark.map_id,
            sequence=mark.sequence,
            map_from_base=correction.pose,
            covariance=correction.covariance,
            establishes=approved.establishes,
        )
