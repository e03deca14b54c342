"""The bridge's side of the `trigpoint` serial protocol (docs/reference/serial.md)."""

from trigpoint import __version__
from trigpoint.base.clock import to_ns
from trigpoint.base.errors import MessageError
from trigpoint.robot.line.protocol import (
    Acknowledged,
    ClockExchange,
    Connected,
    Damaged,
    DamageKind,
    Event,
    LocatedPose,
    Mismatched,
    Missing,
    Reading,
    RobotCorrection,
    Setup,
    Silent,
    StampClock,
    Takes,
    Traits,
    Unanswered,
    Vitals,
)
from trigpoint.robot.line.wheels import WheelOdometry, wheel_geometry

from .framing import DELIMITER, Frame, FrameReader, FrameWriter, SequenceCheck
from .trigpoint_frames import (
    VERSION,
    Acknowledge,
    Content,
    CorrectionFrame,
    Heartbeat,
    Hello,
    OdometryFrame,
    Ping,
    Pong,
    Result,
    TicksFrame,
    decode_payload,
    encode_payload,
    shown_covariance,
)

HELLO_EVERY_NS = to_ns(0.5)
HEARTBEAT_EVERY_NS = to_ns(1.0)
# A burst, so that the clock is known at once, then a steady trickle that follows its drift.
FIRST_PINGS = 10
FIRST_PINGS_EVERY_NS = to_ns(0.02)
PING_EVERY_NS = to_ns(0.5)
SILENCE_NS = to_ns(3.0)
REPEAT_AFTER_NS = to_ns(0.15)
TIMES_SENT = 3
_PINGS_KEPT = 16


class _Outbox:
    """The newest correction, until it is answered or given up."""

    def __init__(self) -> None:
        self._correction: RobotCorrection | None = None
        self._sent_ns: dict[int, int] = {}
        self._times = 0
        self._due_ns = 0

    def replace(self, correction: RobotCorrection) -> None:
        self._correction, self._times, self._due_ns = correction, 0, 0

    def clear(self) -> None:
        self._correction = None
        self._sent_ns.clear()

    @property
    def due_ns(self) -> int | None:
        """When to send (again); None where there is nothing to send."""
        return None if self._correction is None else self._due_ns

    def take(self, now_ns: int) -> RobotCorrection | None:
        """The correction where it is to be sent now."""
        if self._correction is None or now_ns < self._due_ns or self._times >= TIMES_SENT:
            return None
        if self._times == 0:
            self._sent_ns = dict(list(self._sent_ns.items())[-_PINGS_KEPT:])
            self._sent_ns[self._correction.number] = now_ns
        self._times += 1
        self._due_ns = now_ns + REPEAT_AFTER_NS
        return self._correction

    def answered(self, number: int, now_ns: int) -> int | None:
        """The round trip of a correction, ns; None where it was answered before or never sent."""
        if self._correction is not None and self._correction.number == number:
            self._correction = None
        sent_ns = self._sent_ns.pop(number, None)
        return None if sent_ns is None else now_ns - sent_ns

    def given_up(self, now_ns: int) -> int | None:
        """The number of a correction that was sent often enough without an answer."""
        if self._correction is None or self._times < TIMES_SENT or now_ns < self._due_ns:
            return None
        number, self._correction = self._correction.number, None
        return number


class TrigpointSerial:
    """The conversation with one robot; see `Protocol`."""

    traits = Traits(Takes.CORRECTIONS, StampClock.FIRMWARE)

    def __init__(self, setup: Setup) -> None:
        self._robot, self._boot = setup.robot, setup.boot
        self._wheels, self._wheel_config = WheelOdometry(), setup.config.wheels
        self._writer = FrameWriter()
        self._outbox = _Outbox()
        self._received = self._damaged = 0
        self._sequence = SequenceCheck()
        self._sequence_boot: int | None = None
        self._ticks_boot: int | None = None
        self._ping_number = 0
        self.reset()

    def reset(self) -> None:
        self._reader = FrameReader()
        self._heard_ns: int | None = None
        self._is_first_output = True
        self._ask_anew()

    def _ask_anew(self) -> None:
        """Nobody is known to be there; ask who is."""
        self._peer: Hello | None = None
        self._hello_due_ns: int | None = 0
        self._greet()

    def _greet(self) -> None:
        """Start the conversation afresh: nothing sent before may be answered any more."""
        self._pings: dict[int, int] = {}
        self._pings_to_hurry = FIRST_PINGS
        self._ping_due_ns = self._heartbeat_due_ns = 0
        self._outbox.clear()

    # ---- what comes

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        events: list[Event] = []
        for item in self._reader.feed(data):
            if isinstance(item, Damaged):
                self._damaged += 1
                events.append(item)
            else:
                events += self._frame(item, now_ns)
        return events

    def _frame(self, frame: Frame, now_ns: int) -> list[Event]:
        try:
            content = decode_payload(frame.kind, frame.payload)
        except MessageError:
            self._damaged += 1
            return [Damaged(DamageKind.CONTENT)]
        self._received += 1
        self._heard_ns = now_ns
        if isinstance(content, Hello):
            return self._hello(content, frame.sequence)
        if self._peer is None:
            return []  # nobody has said who this is; a hello is under way
        return self._missing(frame.sequence) + self._content(content, now_ns)

    def _hello(self, hello: Hello, sequence: int) -> list[Event]:
        if wrong := self._mismatch(hello):
            self._peer = None
            return [Mismatched(wrong)]
        if self._sequence_boot != hello.boot:
            self._sequence, self._sequence_boot = SequenceCheck(), hello.boot
        events = self._missing(sequence)
        if self._peer is None or self._peer.boot != hello.boot:
            if self._ticks_boot != hello.boot:
                self._wheels, self._ticks_boot = WheelOdometry(), hello.boot
            self._peer = hello
            self._greet()
            self._hello_due_ns = 0  # so that the firmware knows us too, where it spoke first
            name = hello.name or self._robot
            events.append(Connected(name, hello.program, hello.boot))
        return events

    def _missing(self, sequence: int) -> list[Event]:
        missing = self._sequence.missing(sequence)
        return [Missing(missing)] if missing else []

    def _mismatch(self, hello: Hello) -> str:
        if hello.version != VERSION:
            older = "the firmware" if hello.version < VERSION else "this bridge"
            return (
                f"robot «{self._robot}» speaks version {hello.version} of the serial protocol, "
                f"this bridge version {VERSION}; update {older}"
            )
        if hello.name and hello.name != self._robot:
            return (
                f"the robot at the port says that it is «{hello.name}», not «{self._robot}»; "
                "correct `port` in site.toml"
            )
        return ""

    def _content(self, content: Content, now_ns: int) -> list[Event]:
        match content:
            case OdometryFrame():
                return self._odometry(content, now_ns)
            case TicksFrame():
                return self._ticks(content, now_ns)
            case Pong():
                return self._pong(content, now_ns)
            case Acknowledge():
                return self._acknowledged(content, now_ns)
            case Heartbeat():
                return [Vitals(content.received, content.rejected)]
            case _:
                self._damaged += 1
                return [Damaged(DamageKind.CONTENT)]  # only the bridge sends these

    def _odometry(self, content: OdometryFrame, now_ns: int) -> list[Event]:
        if self._is_of_another_boot(content.boot):
            return []
        linear, angular = content.linear, content.angular
        return [Reading(content.stamp_ns, now_ns, content.pose, linear, angular)]

    def _ticks(self, content: TicksFrame, now_ns: int) -> list[Event]:
        if self._is_of_another_boot(content.boot):
            return []
        # The site file's numbers, where it has some, are newer than those in the firmware.
        geometry = wheel_geometry(self._wheel_config, content.geometry.bits) or content.geometry
        stamp_ns = content.stamp_ns
        found = self._wheels.add(content.left, content.right, geometry, stamp_ns)
        return [Reading(stamp_ns, now_ns, *found)]

    def _is_of_another_boot(self, boot: int) -> bool:
        """Whether the firmware was restarted and its hello was lost; asks for it again."""
        if self._peer is None or boot == self._peer.boot:
            return False
        self._ask_anew()
        return True

    def _pong(self, content: Pong, now_ns: int) -> list[Event]:
        sent_ns = self._pings.pop(content.number, None)
        if sent_ns is None or self._is_of_another_boot(content.boot):
            return []
        # The time that the firmware held the ping back is no part of the way.
        held_ns = content.sent_ns - content.received_ns
        if not 0 <= held_ns <= now_ns - sent_ns:
            self._damaged += 1
            return [Damaged(DamageKind.CONTENT)]
        return [ClockExchange(sent_ns, content.received_ns, now_ns - held_ns)]

    def _acknowledged(self, content: Acknowledge, now_ns: int) -> list[Event]:
        round_trip_ns = self._outbox.answered(content.number, now_ns)
        if round_trip_ns is None:
            return []
        reason = content.text or _reason(content.result)
        is_accepted = content.result == Result.ACCEPTED
        return [
            Acknowledged(content.number, is_accepted, "" if is_accepted else reason, round_trip_ns)
        ]

    # ---- what goes

    def correct(self, correction: RobotCorrection) -> None:
        self._outbox.replace(correction)

    def locate(self, pose: LocatedPose) -> None:
        raise NotImplementedError("this protocol takes corrections")

    def data_to_send(self, now_ns: int) -> bytes:
        data = bytearray()
        if self._is_first_output:
            self._is_first_output = False
            data += DELIMITER  # ends whatever half a frame the other side may hold
        data += self._hello_if_due(now_ns)
        if self._peer is None:
            return bytes(data)
        # Pings before the rest: what is written before them would delay them.
        data += self._ping_if_due(now_ns)
        if correction := self._outbox.take(now_ns):
            data += self._encode(_correction_frame(correction))
        if now_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = now_ns + HEARTBEAT_EVERY_NS
            data += self._encode(Heartbeat(now_ns, self._received, self._damaged))
        return bytes(data)

    def _hello_if_due(self, now_ns: int) -> bytes:
        if self._hello_due_ns is None or now_ns < self._hello_due_ns:
            return b""
        self._hello_due_ns = now_ns + HELLO_EVERY_NS if self._peer is None else None
        program = f"trigpoint {__version__}"
        return self._encode(Hello(VERSION, self._boot, self._robot, program))

    def _ping_if_due(self, now_ns: int) -> bytes:
        if now_ns < self._ping_due_ns:
            return b""
        self._ping_number += 1
        self._pings_to_hurry = max(0, self._pings_to_hurry - 1)
        pause_ns = FIRST_PINGS_EVERY_NS if self._pings_to_hurry else PING_EVERY_NS
        self._ping_due_ns = now_ns + pause_ns
        self._pings = dict(list(self._pings.items())[-_PINGS_KEPT:])
        self._pings[self._ping_number] = now_ns
        return self._encode(Ping(self._ping_number))

    def due_ns(self, now_ns: int) -> int:
        if self._is_first_output:
            return now_ns
        due = [self._hello_due_ns]
        if self._peer is not None:
            due += [self._ping_due_ns, self._heartbeat_due_ns, self._outbox.due_ns]
        return min((at for at in due if at is not None), default=now_ns + HELLO_EVERY_NS)

    def elapse(self, now_ns: int) -> list[Event]:
        events: list[Event] = []
        if (number := self._outbox.given_up(now_ns)) is not None:
            events.append(Unanswered(number))
        if self._heard_ns is not None and now_ns - self._heard_ns > SILENCE_NS:
            self._heard_ns = None
            self._ask_anew()
            events.append(Silent())
        return events

    def _encode(self, content: Content) -> bytes:
        return self._writer.write(*encode_payload(content))


def _correction_frame(correction: RobotCorrection) -> CorrectionFrame:
    return CorrectionFrame(
        number=correction.number % 2**32,
        establishes=correction.establishes,
        stamp_ns=correction.firmware_ns,
        map_id=correction.map_id,
        sequence=correction.sequence,
        pose=correction.map_from_base,
        covariance=shown_covariance(correction.covariance),
    )


def _reason(result: int) -> str:
    try:
        return Result(result).name.lower().replace("_", " ")
    except ValueError:
        return f"reason {result}"
