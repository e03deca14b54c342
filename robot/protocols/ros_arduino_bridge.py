"""The serial commands of ros_arduino_bridge's Arduino sketch (Goebel, Nugen, Gallinger, 2012).

After its ROSArduinoBridge.ino and commands.h: 57 600 baud; a command is one letter, ended by a
carriage return; `e` is answered by the left and right encoder counts, «1234 -567» and an end of
line, `r` sets both to zero and is answered by «OK», what it does not know by «Invalid Command». The
counts are the board's `long`, 32 bits.

It answers when asked, and has no clock and no corrections: a reading was taken between question and
answer, and the bridge holds map → odom. Motor commands (`m`) are not ours to send.
"""

import re

from trigpoint.clock import to_ns
from trigpoint.robot.protocol import (
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
)
from trigpoint.robot.wheels import WheelOdometry, wheel_geometry

# The sketch's own control loop runs as often; the contract asks for 20 readings a second or more.
ASK_EVERY_NS = to_ns(1 / 30)
ANSWER_NS = to_ns(0.1)
SILENCE_NS = to_ns(3.0)
ENCODERS, RESET, END = b"e\r", b"r\r", b"\r"
_COUNTS = re.compile(rb" ?(-?[0-9]{1,10}) (-?[0-9]{1,10})")
_LONGEST_LINE = 64
_KNOWN = (b"OK", b"Invalid Command")


class RosArduinoBridge:
    """The conversation with one board; see `Protocol`."""

    traits = Traits(
        Takes.NOTHING,
        StampClock.MACHINE,
        (
            "ros_arduino_bridge takes no corrections: the robot itself does not learn where it is; "
            "its pose is on the bus (corrected, tf)",
            "ros_arduino_bridge has no checksums: a digit that is damaged on the line shows only "
            "where the robot cannot have moved so far",
        ),
    )

    def __init__(self, setup: Setup) -> None:
        self._robot = setup.robot
        self._geometry = wheel_geometry(setup.config.wheels, 32)
        self._wheels = WheelOdometry()
        self._is_reset = False
        self.reset()

    def reset(self) -> None:
        self._buffer = bytearray()
        self._is_overlong = False
        self._is_connected = False
        self._asked_ns: int | None = None
        self._unanswered = 0
        self._heard_ns: int | None = None
        # An end of line first: it ends whatever half a command the board may hold.
        self._waiting = bytearray(END)
        self._ask_due_ns = 0

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        *ended, rest = data.split(b"\n")
        events: list[Event] = []
        for piece in ended:
            self._hold(piece)
            line, is_overlong = bytes(self._buffer).rstrip(b"\r"), self._is_overlong
            self._buffer.clear()
            self._is_overlong = False
            events += self._damage() if is_overlong else self._line(line, now_ns)
        self._hold(rest)
        return events

    def _hold(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > _LONGEST_LINE:
            self._is_overlong = True
            self._buffer.clear()
        elif not self._is_overlong:
            self._buffer += piece

    def _line(self, line: bytes, now_ns: int) -> list[Event]:
        if line in _KNOWN or not line:
            return []
        match = _COUNTS.fullmatch(line)
        if match is None:
            return self._damage()
        asked_ns, self._asked_ns = self._asked_ns, None
        if asked_ns is None:
            return []  # a late answer to a question that was given up: when it was read is unknown
        return self._counts(int(match[1]), int(match[2]), asked_ns, now_ns)

    def _damage(self) -> list[Event]:
        return [Damaged(DamageKind.CONTENT)] if self._is_connected else []

    def _counts(self, left: int, right: int, asked_ns: int, now_ns: int) -> list[Event]:
        if not all(-(2**31) <= count < 2**31 for count in (left, right)):
            return [Damaged(DamageKind.CONTENT)]
        self._heard_ns = now_ns
        if self._geometry is None:
            text = (
                f"robot {self._robot} sends encoder counts; write diameter, track and ticks under "
                f"[robots.{self._robot}.wheels] in site.toml"
            )
            return [Mismatched(text)]
        events: list[Event] = []
        if not self._is_connected:
            self._is_connected = True
            events.append(Connected(self._robot, "ros_arduino_bridge", 0))
        taken_ns = (asked_ns + now_ns) // 2
        found = self._wheels.add(left, right, self._geometry, taken_ns)
        return [*events, Reading(taken_ns, now_ns, *found)]

    def correct(self, correction: RobotCorrection) -> None:
        raise NotImplementedError("this protocol takes no corrections")

    def locate(self, pose: LocatedPose) -> None:
        raise NotImplementedError("this protocol takes no poses")

    def data_to_send(self, now_ns: int) -> bytes:
        data = bytes(self._waiting)
        self._waiting.clear()
        if data and not self._is_reset:
            self._is_reset = True
            data += RESET  # once, so that the counters are far from their ends
        self._give_up(now_ns)
        if now_ns < self._ask_due_ns or self._asked_ns is not None:
            return data
        self._asked_ns, self._ask_due_ns = now_ns, now_ns + ASK_EVERY_NS
        return data + ENCODERS

    def due_ns(self, now_ns: int) -> int:
        if self._waiting:
            return now_ns
        return self._ask_due_ns if self._asked_ns is None else self._asked_ns + ANSWER_NS

    def elapse(self, now_ns: int) -> list[Event]:
        events: list[Event] = []
        self._give_up(now_ns)
        if self._unanswered:
            events.append(Missing(self._unanswered))
            self._unanswered = 0
        if self._heard_ns is not None and now_ns - self._heard_ns > SILENCE_NS:
            self._heard_ns, self._is_connected = None, False
            events.append(Silent())
        return events

    def _give_up(self, now_ns: int) -> None:
        """Ask again where an answer is too late; it could be anyone's by now."""
        if self._asked_ns is not None and now_ns - self._asked_ns >= ANSWER_NS:
            self._asked_ns = None
            self._unanswered += self._is_connected
