"""Every protocol's decoder under a million inputs: no crash, no hang, nothing accepted unsound.

    python -m benchmarks.protocol_fuzz [--inputs 1000000] [--protocols trigpoint,create2,…]

An input is a piece of sound bytes with some flipped, cut, doubled or replaced by noise. «Unsound»
is a reading that none of the sound frames holds (where the frame itself tells the pose).
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from trigpoint.clock import to_ns
from trigpoint.config import RobotConfig, WheelConfig
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.protocol import Reading, Setup, make_protocol
from trigpoint.robot.protocols.create2 import checksum
from trigpoint.robot.protocols.mavlink_frames import dialect

NOW_NS = to_ns(100.0)
FRAMES = 16


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
    wheels = WheelConfig(0.1, 0.3, 1000)
    config = RobotConfig(port="x", protocol=name, wheels=wheels)
    protocol = make_protocol(Setup("r1", config, 1))
    protocol.receive(frames[0], NOW_NS)
    readings = unsound = 0
    longest_s, begin_s = 0.0, time.process_time()
    for k in range(inputs):
        if k % 1000 == 0:
            protocol.reset()
            protocol.receive(frames[0], NOW_NS)
        protocol.data_to_send(NOW_NS + k * 10**8)
        piece = damaged(frames, random)
        before_s = time.thread_time()
        events = protocol.receive(piece, NOW_NS + k * 10**8)
        longest_s = max(longest_s, time.thread_time() - before_s)
        for event in events:
            if isinstance(event, Reading):
                readings += 1
                x = float(event.pose.translation[0])
                unsound += name in ("trigpoint", "mavlink") and x not in range(FRAMES)
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
