"""What a robot's firmware does on its side of the serial line, without a port or a clock.

A real firmware is written in C or C++ after docs/reference/serial.md; this is the same in Python:
for tests, for the simulated robot, and to read beside the document. All times are the firmware's
own clock.
"""

from collections import deque
from uuid import UUID

from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import MessageError
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.robot.line.protocols.framing import Damaged, Frame, FrameReader, FrameWriter
from trigpoint.robot.line.protocols.trigpoint_frames import (
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
)
from trigpoint.robot.line.wheels import WheelGeometry
from trigpoint.robot.odometry.interpolation import interpolated

HISTORY_NS = to_ns(3.0)
HEARTBEAT_EVERY_NS = to_ns(1.0)
# Corrections whose answers are remembered; the bridge repeats only the newest.
REMEMBERED = 32


class Applied(Struct, frozen=True):
    """A correction that the firmware took over."""

    number: int
    bridge: int
    stamp_ns: int
    map_id: UUID
    sequence: int
    establishes: bool
    map_from_base: Pose
    map_from_odom: Pose


class FirmwareEndpoint:
    """One robot's end of the line. `boot` is a number that no earlier start of it had."""

    def __init__(
        self, *, name: str, program: str, boot: int, planar: bool = True, version: int = VERSION
    ) -> None:
        self._hello = Hello(version, boot, name, program)
        self._planar = planar
        self._reader = FrameReader()
        self._writer = FrameWriter()
        self._received = self._rejected = 0
        self._heartbeat_due_ns = 0
        self._history: deque[tuple[int, Pose]] = deque()
        self._bridge = 0
        self._answers: dict[int, Result] = {}
        self._speaks_our_version = False
        self.map_from_odom: Pose | None = None
        self.applied: list[Applied] = []

    def hello(self) -> bytes:
        """To send once at the start; further ones answer the bridge's."""
        return b"\0" + self._encode(self._hello)

    def odometry(self, stamp_ns: int, pose: Pose, linear: Array, angular: Array) -> bytes:
        """One reading: odom_from_base when the encoders were read."""
        self._remember(stamp_ns, pose)
        return self._encode(OdometryFrame(self._hello.boot, stamp_ns, pose, linear, angular))

    def ticks(
        self, stamp_ns: int, left: int, right: int, geometry: WheelGeometry, pose: Pose
    ) -> bytes:
        """The same as raw counters; `pose` is what the firmware itself works out of them, which it
        needs for corrections."""
        self._remember(stamp_ns, pose)
        return self._encode(TicksFrame(self._hello.boot, stamp_ns, left, right, geometry))

    def _remember(self, stamp_ns: int, pose: Pose) -> None:
        self._history.append((stamp_ns, pose))
        while self._history[0][0] < stamp_ns - HISTORY_NS:
            self._history.popleft()

    def heartbeat(self, now_ns: int) -> bytes:
        """The heartbeat where it is due, else nothing."""
        if now_ns < self._heartbeat_due_ns:
            return b""
        self._heartbeat_due_ns = now_ns + HEARTBEAT_EVERY_NS
        return self._encode(Heartbeat(now_ns, self._received, self._rejected))

    @property
    def map_from_base(self) -> Pose | None:
        """Where the robot believes it is; None before the first correction."""
        if self.map_from_odom is None or not self._history:
            return None
        return self.map_from_odom @ self._history[-1][1]

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Work on what came at `now_ns`; return what to answer."""
        answer = b""
        for item in self._reader.feed(data):
            if isinstance(item, Damaged):
                self._rejected += 1
            else:
                answer += self._frame(item, now_ns)
        return answer

    def _frame(self, frame: Frame, now_ns: int) -> bytes:
        try:
            content = decode_payload(frame.kind, frame.payload)
        except MessageError:
            self._rejected += 1
            return b""
        self._received += 1
        return self._content(content, now_ns)

    def _content(self, content: Content, now_ns: int) -> bytes:
        match content:
            case Hello():
                self._speaks_our_version = content.version == self._hello.version
                if content.boot != self._bridge:  # another start of the bridge counts anew
                    self._bridge = content.boot
                    self._answers.clear()
                return self._encode(self._hello)
            case Ping() if self._speaks_our_version:
                # Both times are the same here; a firmware that answers later sends both.
                return self._encode(Pong(content.number, self._hello.boot, now_ns, now_ns))
            case CorrectionFrame() if self._speaks_our_version:
                return self._encode(self._correct(content))
            case _:
                return b""

    def _correct(self, correction: CorrectionFrame) -> Acknowledge:
        """A number that came before, since its answer was lost, is answered as before."""
        number = correction.number
        if number not in self._answers:
            recent = list(self._answers.items())[-REMEMBERED + 1 :]
            self._answers = dict([*recent, (number, self._apply(correction))])
        return Acknowledge(number, self._answers[number], "")

    def _apply(self, correction: CorrectionFrame) -> Result:
        odom_from_base = interpolated(list(self._history), correction.stamp_ns)
        if odom_from_base is None:
            return Result.TOO_OLD
        if self._planar and abs(correction.pose.rotation[2, 2] - 1) > 1e-6:
            return Result.INVALID
        map_from_odom = correction.pose @ odom_from_base.inverse()
        self.map_from_odom = map_from_odom
        self.applied.append(
            Applied(
                correction.number,
                self._bridge,
                correction.stamp_ns,
                correction.map_id,
                correction.sequence,
                correction.establishes,
                correction.pose,
                map_from_odom,
            )
        )
        return Result.ACCEPTED

    def _encode(self, content: Content) -> bytes:
        return self._writer.write(*encode_payload(content))
