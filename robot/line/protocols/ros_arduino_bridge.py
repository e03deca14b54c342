"""The serial commands of ros_arduino_bridge's Arduino sketch (Goebel, Nugen, Gallinger, 2012).

After its ROSArduinoBridge.ino and commands.h: 57 600 baud; a command is one letter, ended by a
carriage return; `e` is answered by the left and right encoder counts, «1234 -567» and an end of
line, `r` sets both to zero and is answered by «OK», what it does not know by «Invalid Command». The
counts are the board's `long`, 32 bits. What its forks may do otherwise is in
decisions/0305-boards-that-answer-with-counts.md.

It answers when asked, and has no clock and no corrections: a reading was taken between question and
answer, and the bridge holds map → odom. Motor commands (`m`) are not ours to send.

Answers do not say which question they belong to, and on a busy machine those of a second may come
at once. They come in the questions' order, so an answer belongs to the oldest question that may
still be open or to a later one: it is read where even the oldest was asked a moment ago.
"""

import re
from collections import deque

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.robot.line.encoders import UNUSED, USUAL_BITS, Encoders
from trigpoint.robot.line.protocol import (
    Advice,
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
    readable,
)
from trigpoint.robot.line.wheels import WheelOdometry, wheel_geometry

# The sketch's own control loop runs as often; the contract asks for 20 readings a second or more.
ASK_EVERY_NS = to_ns(1 / 30)
ANSWER_NS = to_ns(0.1)
# Where an answer came, but fewer than questions were asked: so long after the last question those
# that are left were lost, by the board or on the line.
LOST_NS = to_ns(0.25)
SILENCE_NS = to_ns(3.0)
ENCODERS, RESET, END = b"e\r", b"r\r", b"\r"
_END_OF_LINE = re.compile(rb"[\r\n]")
_NUMBER = re.compile(r"[-+]?[0-9]{1,10}(\.[0-9]{1,6})?")
_LONGEST_LINE = 128
_REFUSAL = "Invalid Command"
# What a board says beside its answers: to `r`, or the question itself where it echoes.
_KNOWN = ("", "OK", "e", "r")
# One wrong line may be noise, or the rest of another command's answer.
_TOLERATED = 3
# That no answer comes in time for so long is no accident of a board's start, nor of a machine that
# was busy.
_LATE_NS = to_ns(2.0)
_SAY_EVERY_NS = to_ns(5.0)
# Six seconds of them: a reader that is held up for longer is started anew.
_MOST_OPEN = 64


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
        self._geometry = wheel_geometry(setup.config.wheels, USUAL_BITS)
        self._encoders = Encoders(setup.config, self._geometry) if self._geometry else None
        self._wheels, self._boot = WheelOdometry(), 0
        self._is_reset = False
        self._said_ns: int | None = None
        self.reset()

    def reset(self) -> None:
        self._buffer = bytearray()
        self._is_overlong = False
        self._is_connected = False
        # When the questions were asked whose answers may still come.
        self._open: deque[int] = deque(maxlen=_MOST_OPEN)
        # Whether the newest may be answered in time; whether an answer came since it was asked.
        self._is_awaited = self._is_heard = False
        self._unanswered = self._wrong_lines = 0
        self._heard_ns: int | None = None
        # When the first of the answers came that are late, without one in time since.
        self._late_ns: int | None = None
        # An end of line first: it ends whatever half a command the board may hold.
        self._waiting = bytearray(END)
        self._ask_due_ns = 0

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        *ended, rest = _END_OF_LINE.split(data)
        events: list[Event] = []
        for piece in ended:
            self._hold(piece)
            line, is_overlong = bytes(self._buffer), self._is_overlong
            self._buffer.clear()
            self._is_overlong = False
            events += self._damage() if is_overlong else self._line(readable(line), now_ns)
        self._hold(rest)
        return events

    def _hold(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > _LONGEST_LINE:
            self._is_overlong = True
            self._buffer.clear()
        elif not self._is_overlong:
            self._buffer += piece

    def _line(self, line: str, now_ns: int) -> list[Event]:
        if line in _KNOWN:
            return []
        numbers = _numbers(line)
        if numbers is not None and self._encoders is None:
            return [self._unknown_wheels()]
        if numbers is None or self._encoders is None or len(numbers) != self._encoders.columns:
            return self._wrong(line, numbers, now_ns)
        counts = self._encoders.counts(numbers)
        if counts is None:
            return self._damage()
        self._wrong_lines = 0
        asked_ns = self._answered(now_ns)
        if asked_ns is None or now_ns - asked_ns > ANSWER_NS:
            return self._late(line, now_ns)
        return self._read(self._encoders, counts, asked_ns, now_ns)

    def _answered(self, now_ns: int) -> int | None:
        """When the oldest question was asked that an answer of now may belong to."""
        self._give_up(now_ns)
        if not self._open:
            return None
        self._heard_ns, self._is_heard = now_ns, True
        asked_ns = self._open.popleft()
        self._is_awaited = self._is_awaited and bool(self._open)
        return asked_ns

    def _unknown_wheels(self) -> Mismatched:
        return Mismatched(
            f"robot {self._robot} sends encoder counts; write diameter, track and ticks under "
            f"[robots.{self._robot}.wheels] in site.toml"
        )

    def _read(
        self, encoders: Encoders, counts: list[float], asked_ns: int, now_ns: int
    ) -> list[Event]:
        assert self._geometry is not None  # there are no encoders without it
        self._late_ns = None
        taken_ns = (asked_ns + now_ns) // 2
        turned = encoders.add(counts, taken_ns)
        events: list[Event] = []
        if turned.restarted:
            self._boot += 1
            self._wheels = WheelOdometry()
        if turned.restarted or not self._is_connected:
            self._is_connected = True
            events.append(Connected(self._robot, "ros_arduino_bridge", self._boot))
        if turned.narrowed:
            events.append(self._advice("the counts wrap at 16 bits; write bits = 16"))
        found = self._wheels.add_way(
            turned.left_m, turned.right_m, self._geometry.track_m, turned.elapsed_s
        )
        return [*events, Reading(taken_ns, now_ns, *found, doubt_ns=now_ns - taken_ns)]

    def _advice(self, text: str) -> Advice:
        return Advice(f"robot {self._robot}: {text} under [robots.{self._robot}.wheels]")

    def _damage(self, text: str = "") -> list[Event]:
        return [Damaged(DamageKind.CONTENT, text)] if self._is_connected or text else []

    def _late(self, line: str, now_ns: int) -> list[Event]:
        """Counts of which it is not known well enough when they were read; told now and then of a
        board that sends no others, or no longer any."""
        self._late_ns = now_ns if self._late_ns is None else self._late_ns
        late_ns = now_ns - self._late_ns
        if late_ns < _LATE_NS or self._is_told(now_ns):
            return []
        self._said_ns, self._is_connected = now_ns, False
        return [
            Mismatched(
                f"robot {self._robot} answers «{line}», but for the last "
                f"{to_seconds(late_ns):.0f} s later than {to_seconds(ANSWER_NS):g} s after it was "
                "asked, so when its wheels were there is not known; does its sketch wait in its "
                "loop (delay, sonar), or is `baud` too low?"
            )
        ]

    def _is_told(self, now_ns: int) -> bool:
        return self._said_ns is not None and now_ns - self._said_ns < _SAY_EVERY_NS

    def _wrong(self, line: str, numbers: list[float] | None, now_ns: int) -> list[Event]:
        """A line that is no answer; several in a row are told now and then."""
        self._wrong_lines += 1
        if self._wrong_lines < _TOLERATED or self._is_told(now_ns):
            return [] if line == _REFUSAL else self._damage()
        self._said_ns = now_ns
        answers = f"robot {self._robot} answers «{line}»"
        if line == _REFUSAL:
            return [
                Mismatched(
                    f"{answers} where its encoder counts are asked for (`e`); is its sketch "
                    "compiled with USE_BASE and an encoder?"
                )
            ]
        if numbers is not None and self._encoders is not None:
            return [
                Mismatched(
                    f"{answers}, {len(numbers)} numbers instead of {self._encoders.columns}; say "
                    f"which is of which side under [robots.{self._robot}.wheels], like "
                    f'order = "{_example_order(len(numbers))}" (-: of none)'
                )
            ]
        return self._damage(
            f"{answers}, which is not read as counts; two numbers are, with blanks or a comma "
            "between them. Are `protocol` and `baud` the firmware's?"
        )

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
        if now_ns < self._ask_due_ns or self._is_awaited:
            return data
        self._open.append(now_ns)
        self._is_awaited, self._is_heard = True, False
        self._ask_due_ns = now_ns + ASK_EVERY_NS
        return data + ENCODERS

    def due_ns(self, now_ns: int) -> int:
        if self._waiting:
            return now_ns
        return self._give_up_ns() if self._is_awaited else self._ask_due_ns

    def _give_up_ns(self) -> int:
        return self._open[-1] + (LOST_NS if self._is_heard else ANSWER_NS)

    def elapse(self, now_ns: int) -> list[Event]:
        events: list[Event] = []
        self._give_up(now_ns)
        if self._unanswered:
            events.append(Missing(self._unanswered))
            self._unanswered = 0
        if self._heard_ns is not None and now_ns - self._heard_ns > SILENCE_NS:
            self._heard_ns, self._late_ns, self._is_connected = None, None, False
            events.append(Silent())
        return events

    def _give_up(self, now_ns: int) -> None:
        """Ask again where an answer is too late. The question stays open where nothing was heard
        since: its answer may be here already, with nobody who read it."""
        if not self._is_awaited or now_ns < self._give_up_ns():
            return
        self._is_awaited = False
        self._unanswered += self._is_connected
        if self._is_heard:
            self._open.clear()


def _example_order(columns: int) -> str:
    return "lr" * (columns // 2) + UNUSED * (columns % 2)


def _numbers(line: str) -> list[float] | None:
    """The numbers of an answer, separated by blanks or by commas and all with a point or all
    without: «12,5 13,5» could be read in two ways. None if it is anything else."""
    separator = next((one for one in ",;" if one in line), None)
    fields = [field.strip() for field in line.split(separator)]
    matches = [_NUMBER.fullmatch(field) for field in fields]
    found = [match for match in matches if match is not None]
    if len(fields) < 2 or len(found) < len(fields) or len({not m[1] for m in found}) > 1:
        return None
    return [float(match[0]) for match in found]
