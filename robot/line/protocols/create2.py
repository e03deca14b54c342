"""iRobot's Open Interface, as Create 2 and the Roomba 600 series speak it.

After the «iRobot Create 2 Open Interface (OI) Specification based on the iRobot Roomba 600»:
115 200 baud; START (128) opens the interface in passive mode; STREAM (148) has the robot send the
listed sensor packets every 15 ms as header 19, number of bytes, each packet's id and data, and a
checksum, with which all bytes from the header on sum up to 0 modulo 256. Packets 43 and 44 are the
left and right encoder counts, two bytes, high byte first, that wrap at 16 bits; 508.8 counts a turn
of a wheel of 72 mm, wheels 235 mm apart.

The interface has no clock, no name and no corrections: the bridge holds map → odom.
"""

import struct

from trigpoint.base.clock import to_ns
from trigpoint.robot.line.arrival import ArrivalClock
from trigpoint.robot.line.protocol import (
    Connected,
    Damaged,
    DamageKind,
    Event,
    LocatedPose,
    Reading,
    RobotCorrection,
    Setup,
    Silent,
    StampClock,
    Takes,
    Traits,
)
from trigpoint.robot.line.wheels import WheelOdometry, wheel_geometry

START, STREAM, HEADER = 128, 148, 19
LEFT, RIGHT = 43, 44
DIAMETER_M, TRACK_M, TICKS = 0.072, 0.235, 508.8
PERIOD_NS = to_ns(0.015)
SILENCE_NS = to_ns(1.0)
REQUEST = bytes([START, STREAM, 2, LEFT, RIGHT])
_CONTENT = struct.Struct(">BHBH")
_FRAME = 2 + _CONTENT.size + 1


def checksum(data: bytes) -> int:
    """The byte with which all sum up to 0 modulo 256."""
    return -sum(data) % 256


class StreamReader:
    """Bytes in, contents of sound stream frames out, however the bytes are cut; after garbage the
    next sound frame is found at once. Holds less than one frame's bytes."""

    def __init__(self, content_size: int) -> None:
        self._size = content_size
        self._buffer = bytearray()

    def feed(self, data: bytes) -> tuple[list[bytes], int]:
        """(the contents of the frames that `data` completes, how many stretches were damaged)."""
        self._buffer += data
        found, damaged, is_damaged = [], 0, False
        while (content := self._take()) is not None:
            if content:
                found.append(content)
            elif not is_damaged:
                damaged += 1
            is_damaged = not content
        return found, damaged

    def _take(self) -> bytes | None:
        """The next frame's content; b"" where a byte was thrown away; None where more must come."""
        buffer, whole = self._buffer, self._size + 3
        if not buffer or (buffer[0] == HEADER and len(buffer) == 1):
            return None
        if buffer[0] != HEADER or buffer[1] != self._size:
            del buffer[0]
            return b""
        if len(buffer) < whole:
            return None
        frame = bytes(buffer[:whole])
        if sum(frame) % 256:
            del buffer[0]
            return b""
        del buffer[:whole]
        return frame[2:-1]


class Create2:
    """The conversation with one robot; see `Protocol`."""

    traits = Traits(
        Takes.NOTHING,
        StampClock.MACHINE,
        (
            "the Open Interface takes no corrections: the robot itself does not learn where it is; "
            "its pose is on the bus (corrected, tf)",
            "the Open Interface has no times: readings are stamped by their arrival",
            "the encoders do not see which way a wheel is pushed: by hand it only counts forward",
        ),
    )

    def __init__(self, setup: Setup) -> None:
        geometry = wheel_geometry(
            setup.config.wheels, 16, diameter_m=DIAMETER_M, track_m=TRACK_M, ticks=TICKS
        )
        assert geometry is not None  # the robot's own numbers are whole
        self._robot, self._geometry = setup.robot, geometry
        self._wheels = WheelOdometry()
        # Ten bits a byte: start, eight, stop.
        self._line_ns = _FRAME * 10 * 10**9 // setup.config.baud
        self.reset()

    def reset(self) -> None:
        self._reader = StreamReader(_CONTENT.size)
        self._clock = ArrivalClock(PERIOD_NS, self._line_ns)
        self._is_connected = False
        self._is_synchronised = False
        self._heard_ns: int | None = None
        self._ask_due_ns = 0

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        contents, damaged = self._reader.feed(data)
        # What comes before the first frame may be the rest of one, or what it says when it wakes.
        events: list[Event] = []
        if self._is_synchronised:
            events += [Damaged(DamageKind.CHECKSUM)] * damaged
        for waited, content in zip(range(len(contents))[::-1], contents, strict=True):
            # Of several at once only the last came now.
            events += self._content(content, now_ns - waited * PERIOD_NS)
        return events

    def _content(self, content: bytes, now_ns: int) -> list[Event]:
        left_id, left, right_id, right = _CONTENT.unpack(content)
        if (left_id, right_id) != (LEFT, RIGHT):
            return [Damaged(DamageKind.CONTENT)]
        events: list[Event] = []
        self._heard_ns, self._is_synchronised = now_ns, True
        if not self._is_connected:
            self._is_connected = True
            events.append(Connected(self._robot, "iRobot Open Interface", 0))
        taken_ns = self._clock.taken_ns(now_ns)
        found = self._wheels.add(left, right, self._geometry, taken_ns)
        return [*events, Reading(taken_ns, now_ns, *found)]

    def correct(self, correction: RobotCorrection) -> None:
        raise NotImplementedError("this protocol takes no corrections")

    def locate(self, pose: LocatedPose) -> None:
        raise NotImplementedError("this protocol takes no poses")

    def data_to_send(self, now_ns: int) -> bytes:
        if now_ns < self._ask_due_ns:
            return b""
        self._ask_due_ns = now_ns + SILENCE_NS
        return b"" if self._is_connected else REQUEST

    def due_ns(self, now_ns: int) -> int:  # noqa: ARG002 - the interface gives it
        return self._ask_due_ns

    def elapse(self, now_ns: int) -> list[Event]:
        if self._heard_ns is None or now_ns - self._heard_ns <= SILENCE_NS:
            return []
        self._heard_ns, self._is_connected, self._ask_due_ns = None, False, now_ns
        return [Silent()]
