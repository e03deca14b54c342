"""How simulated robots speak: one class for each protocol, without a port.

Each is the vendor's side of the line as its documents have it, told by the robot's readings alone.
"""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import Applied, FirmwareEndpoint
from trigpoint.robot.line.protocols import create2, mavlink
from trigpoint.robot.line.protocols.mavlink_frames import dialect
from trigpoint.site.config import WheelConfig

from .readings import Readings

PROGRAM = "trigpoint simulated firmware"
WHEELS = {
    "create2": WheelConfig(create2.DIAMETER_M, create2.TRACK_M, create2.TICKS),
    "ros_arduino_bridge": WheelConfig(0.146, 0.2969, 8384.0),  # its README's robot
}
"""The drives of robots that send counts."""


class FirmwareClock(Struct, frozen=True):
    """The firmware's own clock: 0 at `start_ns` (Unix time), fast by `drift_ppm`."""

    start_ns: int
    drift_ppm: float

    def at(self, unix_ns: int) -> int:
        """What it reads at a Unix time."""
        elapsed_ns = unix_ns - self.start_ns
        return elapsed_ns + round(elapsed_ns * self.drift_ppm * 1e-6)

    def unix_ns(self, own_ns: int) -> int:
        """The Unix time at which it reads so much."""
        return self.start_ns + round(own_ns / (1 + self.drift_ppm * 1e-6))


class Speaker(ABC):
    """One robot's end of the line, which by itself takes no corrections. Times are Unix."""

    @abstractmethod
    def receive(self, data: bytes, unix_ns: int) -> bytes:
        """Answer what came."""

    @abstractmethod
    def speak(self, unix_ns: int) -> bytes:
        """What is due by now."""

    @abstractmethod
    def due_ns(self) -> int:
        """When it speaks next."""

    def begin(self) -> bytes:
        """What it says when it is switched on."""
        return b""

    def applied(self) -> list[tuple[Applied, int]]:
        """Corrections that were taken over since this was asked last, with their moments."""
        return []

    def believed(self, unix_ns: int) -> Pose | None:  # noqa: ARG002 - it never knows
        """Where the robot believes it is; None where it does not know, or cannot."""
        return None


class TrigpointSpeaker(Speaker):
    """Our own firmware; `zero`: the counters restart, so its odometry starts at the origin."""

    def __init__(
        self, endpoint: FirmwareEndpoint, readings: Readings, clock: FirmwareClock, *, zero: bool
    ) -> None:
        self._endpoint, self._readings, self._clock = endpoint, readings, clock
        self._next = readings.first_after(clock.start_ns)
        start = readings.pose(self._next)
        self._counted_from_odom = start.inverse() if zero else Pose.identity()

    def begin(self) -> bytes:
        return self._endpoint.hello()

    def receive(self, data: bytes, unix_ns: int) -> bytes:
        return self._endpoint.receive(data, self._clock.at(unix_ns))

    def speak(self, unix_ns: int) -> bytes:
        said = b""
        while self._readings.unix_ns(self._next) <= unix_ns:
            stamp_ns = self._readings.unix_ns(self._next)
            pose = self._counted_from_odom @ self._readings.pose(self._next)
            twist = self._readings.twist(self._next)
            said += self._endpoint.odometry(self._clock.at(stamp_ns), pose, *twist)
            self._next += 1
        return said + self._endpoint.heartbeat(self._clock.at(unix_ns))

    def due_ns(self) -> int:
        return self._readings.unix_ns(self._next)

    def applied(self) -> list[tuple[Applied, int]]:
        found = [(each, self._clock.unix_ns(each.stamp_ns)) for each in self._endpoint.applied]
        self._endpoint.applied.clear()
        return found

    def believed(self, unix_ns: int) -> Pose | None:  # noqa: ARG002 - it knows its newest reading
        return self._endpoint.map_from_base


class Create2Speaker(Speaker):
    """iRobot's Open Interface: streams both encoders every 15 ms when it is asked to."""

    def __init__(self, readings: Readings, start_ns: int) -> None:
        self._readings = readings
        self._due_ns = start_ns
        self._is_streaming = False
        self._received = b""
        self._metres = np.pi * create2.DIAMETER_M / create2.TICKS

    def receive(self, data: bytes, unix_ns: int) -> bytes:
        self._received = (self._received + data)[-len(create2.REQUEST) :]
        if self._received == create2.REQUEST:
            self._is_streaming, self._due_ns = True, unix_ns
        return b""

    def speak(self, unix_ns: int) -> bytes:
        said = b""
        while self._due_ns <= unix_ns:
            if self._is_streaming:
                said += self._frame(self._due_ns)
            self._due_ns += create2.PERIOD_NS
        return said

    def _frame(self, unix_ns: int) -> bytes:
        left, right = (
            int(np.floor(way / self._metres)) % (1 << 16)
            for way in self._readings.wheels_m(unix_ns, create2.TRACK_M)
        )
        body = bytes([create2.HEADER, 6, create2.LEFT, *left.to_bytes(2, "big")])
        body += bytes([create2.RIGHT, *right.to_bytes(2, "big")])
        return body + bytes([create2.checksum(body)])

    def due_ns(self) -> int:
        return self._due_ns


class ArduinoSpeaker(Speaker):
    """ros_arduino_bridge's sketch: answers `e` and `r`, each ended by a carriage return."""

    def __init__(self, readings: Readings, start_ns: int) -> None:
        self._readings, self._start_ns = readings, start_ns
        wheels = WHEELS["ros_arduino_bridge"]
        self._metres, self._track_m = np.pi * wheels.diameter / wheels.ticks, wheels.track
        self._command = b""
        self._zero = np.zeros(2, dtype=int)

    def receive(self, data: bytes, unix_ns: int) -> bytes:
        *commands, rest = (self._command + data).split(b"\r")
        self._command = rest[-32:]
        return b"".join(self._answer(command, unix_ns) for command in commands)

    def _answer(self, command: bytes, unix_ns: int) -> bytes:
        ways = self._readings.wheels_m(unix_ns, self._track_m)
        counts = np.floor(np.array(ways) / self._metres).astype(int)
        match command:
            case b"e":
                left, right = counts - self._zero
                return b"%d %d\r\n" % (left, right)
            case b"r":
                self._zero = counts
                return b"OK\r\n"
            case _:
                return b"Invalid Command\r\n"

    def speak(self, unix_ns: int) -> bytes:
        self._start_ns = unix_ns + to_ns(1.0)  # it says nothing by itself
        return b""

    def due_ns(self) -> int:
        return self._start_ns


class MavlinkSpeaker(Speaker):
    """A rover's autopilot: ODOMETRY, heartbeats, answers to TIMESYNC; hears where it is."""

    def __init__(self, readings: Readings, clock: FirmwareClock) -> None:
        self._readings, self._clock = readings, clock
        self._next = readings.first_after(clock.start_ns)
        self._codec: Any = dialect().MAVLink(None, srcSystem=1, srcComponent=1)
        self._ears: Any = dialect().MAVLink(None)
        self._ears.robust_parsing = True
        self._heartbeat_due_ns = 0
        self._map_from_odom: Pose | None = None

    def receive(self, data: bytes, unix_ns: int) -> bytes:
        answer = b""
        for message in self._ears.parse_buffer(bytearray(data)) or []:
            match message.get_type():
                case "TIMESYNC" if message.tc1 == 0:
                    own_ns = self._clock.at(unix_ns)
                    answer += self._say(dialect().MAVLink_timesync_message(own_ns, message.ts1))
                case "ODOMETRY":
                    self._locate(message)
        return answer

    def _locate(self, message: Any) -> None:
        """As external navigation: the pose is of a moment, the robot's own odometry goes on."""
        w, x, y, z = message.q
        said = Pose.from_quaternion([message.x, message.y, message.z], [x, y, z, w])
        number = self._readings.number(self._clock.unix_ns(message.time_usec * 1000))
        self._map_from_odom = mavlink.turned(said) @ self._readings.pose(number).inverse()

    def speak(self, unix_ns: int) -> bytes:
        said = b""
        if unix_ns >= self._heartbeat_due_ns:
            self._heartbeat_due_ns = unix_ns + to_ns(1.0)
            said += self._say(dialect().MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3))
        while self._readings.unix_ns(self._next) <= unix_ns:
            said += self._say(self._odometry(self._next))
            self._next += 1
        return said

    def _odometry(self, number: int) -> Any:
        stamp_us = self._clock.at(self._readings.unix_ns(number)) // 1000
        pose = mavlink.turned(self._readings.pose(number))
        x, y, z = (float(value) for value in pose.translation)
        qx, qy, qz, qw = (float(value) for value in pose.quaternion)
        fields: tuple[Any, ...] = (
            max(stamp_us, 0), mavlink.LOCAL_FRD, mavlink.BODY_FRD, x, y, z, [qw, qx, qy, qz],
            *(0.0,) * 6, [float("nan")] * 21, [float("nan")] * 21, 0, 0, 100,
        )  # fmt: skip
        return dialect().MAVLink_odometry_message(*fields)

    def _say(self, message: Any) -> bytes:
        data = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        return data

    def due_ns(self) -> int:
        return self._readings.unix_ns(self._next)

    def believed(self, unix_ns: int) -> Pose | None:
        if self._map_from_odom is None:
            return None
        return self._map_from_odom @ self._readings.pose(self._readings.number(unix_ns))
