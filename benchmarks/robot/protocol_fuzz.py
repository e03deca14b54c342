"""Every protocol's decoder under a million inputs: no crash, no hang, nothing accepted unsound.

    python -m benchmarks.robot.protocol_fuzz [--inputs 1000000] [--protocols trigpoint,create2,…]

An input is a piece of sound bytes with some flipped, cut, doubled or replaced by noise. «Unsound»
is a reading that no frame with a right check holds: none of those that were made (where the frame
itself tells pose and time), or none that can be found in the bytes (where it tells two counters).
"""

import argparse
import re
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.line.protocol import Reading, Setup, make_protocol
from trigpoint.robot.line.protocols.create2 import DIAMETER_M, TICKS, TRACK_M, checksum
from trigpoint.robot.line.protocols.mavlink_frames import dialect
from trigpoint.site.config import RobotConfig, WheelConfig

NOW_NS = to_ns(100.0)
FRAMES = 16
WHEELS = WheelConfig(0.1, 0.3, 1000)


def trigpoint_frames() -> list[bytes]:
    robot = FirmwareEndpoint(name="r1", program="fuzz", boot=3)
    said = [robot.hello()]
    for k in range(FRAMES):
        pose = Pose.planar(float(k), 0, 0)
        said.append(robot.odometry(to_ns(0.02 * k), pose, np.zeros(3), np.zeros(3)))
    return said


def create2_frames() -> list[bytes]:
    bodies = [bytes([19, 6, 43, 0, k, 44, 0, k]) for k in range(FRAMES)]
    return [body + bytes([checksum(body)]) for body in bodies]


def mavlink_frames() -> list[bytes]:
    codec, found = dialect().MAVLink(None, srcSystem=1, srcComponent=1), []
    for k in range(FRAMES):
        codec.seq = k
        fields = (20_000 * k, 20, 12, float(k), 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], *(0.0,) * 6)
        nothing = [0.0] * 21
        message = dialect().MAVLink_odometry_message(*fields, nothing, nothing, 0, 0, 0)
        found.append(bytes(message.pack(codec)))
    return found


def arduino_frames() -> list[bytes]:
    return [b"%d %d\r\n" % (k * 10, k * 10) for k in range(FRAMES)]


FRAMES_OF: dict[str, Callable[[], list[bytes]]] = {
    "trigpoint": trigpoint_frames,
    "create2": create2_frames,
    "mavlink": mavlink_frames,
    "ros_arduino_bridge": arduino_frames,
}


class Oracle(Protocol):
    """Knows by other means than the decoder what a stream of bytes says."""

    def hear(self, data: bytes) -> None:
        """What the decoder is given next; nothing of before counts where it was reset."""
        ...

    def reset(self) -> None:
        """The decoder forgets half a frame."""
        ...

    def vouches_for(self, reading: Reading) -> bool:
        """Whether a sound frame says so."""
        ...


class MadeFrames:
    """For frames that hold all that a reading says."""

    def hear(self, data: bytes) -> None:
        pass

    def reset(self) -> None:
        pass

    def vouches_for(self, reading: Reading) -> bool:
        pose = reading.pose
        x = float(pose.translation[0])
        is_made = x in range(FRAMES) and reading.firmware_ns == round(x) * to_ns(0.02)
        return (
            is_made and np.array_equal(pose.rotation, np.eye(3)) and not pose.translation[1:].any()
        )


class FoundCounts:
    """For frames of two counters: a reading's steps since the one before must lead from counters
    in a sound frame to counters in a sound frame. `found`: those in a stretch of bytes; `rest`:
    how much of its end may be the begin of a frame."""

    def __init__(
        self,
        found: Callable[[bytes], set[tuple[int, int]]],
        rest: Callable[[bytes], bytes],
        tick_m: float,
        track_m: float,
        bits: int,
    ) -> None:
        self._found, self._rest = found, rest
        self._tick_m, self._track_m, self._wrap = tick_m, track_m, 1 << bits
        self._bytes, self._sound = b"", set[tuple[int, int]]()
        self._last: set[tuple[int, int]] | None = None
        self._last_ns = 0

    def hear(self, data: bytes) -> None:
        self._bytes = self._rest(self._bytes) + data
        self._sound = self._found(self._bytes)

    def reset(self) -> None:
        self._bytes = b""

    def vouches_for(self, reading: Reading) -> bool:
        elapsed_s, self._last_ns = (reading.firmware_ns - self._last_ns) / 1e9, reading.firmware_ns
        if self._last is None:
            self._last = self._sound
            return bool(self._sound)
        way = float(reading.linear[0]) * elapsed_s / self._tick_m
        half_turn = 0.5 * self._track_m * float(reading.angular[2]) * elapsed_s / self._tick_m
        left, right = round(way - half_turn), round(way + half_turn)
        after = {((a + left) % self._wrap, (b + right) % self._wrap) for a, b in self._last}
        sound = {pair for pair in self._sound if tuple(c % self._wrap for c in pair) in after}
        self._last = sound or self._sound
        return bool(sound)


_LINE = re.compile(rb"(?:^|\n) ?(-?[0-9]+) (-?[0-9]+)\r*(?=\n)")


def create2_counts(data: bytes) -> set[tuple[int, int]]:
    found = set()
    for begin in range(len(data) - 8):
        frame = data[begin : begin + 9]
        if frame[:3] == b"\x13\x06\x2b" and frame[5] == 44 and sum(frame) % 256 == 0:
            found.add((frame[3] << 8 | frame[4], frame[6] << 8 | frame[7]))
    return found


def arduino_counts(data: bytes) -> set[tuple[int, int]]:
    return {(int(left), int(right)) for left, right in _LINE.findall(data)}


def oracle(name: str) -> Oracle:
    if name == "create2":
        tick_m = np.pi * DIAMETER_M / TICKS
        return FoundCounts(create2_counts, lambda data: data[-8:], tick_m, TRACK_M, 16)
    if name == "ros_arduino_bridge":
        tick_m = np.pi * WHEELS.diameter / WHEELS.ticks
        after_line = lambda data: data[data.rfind(b"\n") + 1 :]  # noqa: E731
        return FoundCounts(arduino_counts, after_line, tick_m, WHEELS.track, 32)
    return MadeFrames()


def damaged(frames: list[bytes], random: np.random.Generator) -> bytes:
    """A few frames, one of them spoilt."""
    begin = int(random.integers(0, len(frames) - 2))
    data = bytearray(b"".join(frames[begin : begin + 3]))
    at, kind = int(random.integers(0, len(data))), int(random.integers(0, 5))
    length = int(random.integers(1, 9))
    match kind:
        case 0:
            data[at] ^= 1 << int(random.integers(0, 8))
        case 1:
            del data[at : at + length]
        case 2:
            data[at:at] = data[at : at + length]
        case 3:
            data[at : at + length] = random.bytes(length)
        case _:
            data = bytearray(random.bytes(int(random.integers(1, 120))))
    return bytes(data)


def run(name: str, inputs: int, seed: int) -> None:
    random, frames = np.random.default_rng(seed), FRAMES_OF[name]()
    wheels = WHEELS if name == "ros_arduino_bridge" else WheelConfig()
    config = RobotConfig(port="x", protocol=name, wheels=wheels)
    protocol, truth = make_protocol(Setup("r1", config, 1)), oracle(name)
    readings = unsound = 0
    longest_s, begin_s = 0.0, time.process_time()
    for k in range(inputs):
        if k % 1000 == 0:
            protocol.reset()
            truth.reset()
        protocol.data_to_send(NOW_NS + k * 10**8)
        piece = (frames[0] if k % 1000 == 0 else b"") + damaged(frames, random)
        truth.hear(piece)
        before_s = time.thread_time()
        events = protocol.receive(piece, NOW_NS + k * 10**8)
        longest_s = max(longest_s, time.thread_time() - before_s)
        for event in events:
            if isinstance(event, Reading):
                readings += 1
                unsound += not truth.vouches_for(event)
    spent_s = time.process_time() - begin_s
    print(
        f"{name}: {inputs} inputs, {readings} readings, {unsound} unsound; "
        f"{1e6 * spent_s / inputs:.0f} µs each, longest {1e3 * longest_s:.1f} ms",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--protocols", default=",".join(FRAMES_OF))
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for name in arguments.protocols.split(","):
        run(name, arguments.inputs, arguments.seed)


if __name__ == "__main__":
    main()
