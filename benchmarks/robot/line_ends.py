"""What the robot bridge's benchmark has at both ends: a robot, and the barest bridge there can be.

Both run as processes of their own. All times are the machine's monotonic clock, which the robot's
own clock is too.
"""

import json
import os
import select
import sys
import time

import numpy as np
import zenoh

from benchmarks.network.bus_wire import open_bare
from trigpoint.geometry import Pose
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint

FRAME = 64
"""Bytes of a frame of the bare bridge: about what a reading and a correction have."""
BARE_ODOMETRY, BARE_CORRECTION = "bare/odom", "bare/correction"
STEP_M = 1e-4
"""How far the robot drives from reading to reading, so that a pose tells which one it is."""
_LONGEST_WAIT_S = 0.05


class Robot:
    """A firmware on one line and a sender of numbered frames on another, by turns. It keeps when
    each reading was written and when each correction's bytes had come."""

    def __init__(self, ours: int, bare: int, rate: float) -> None:
        self._ours, self._bare = ours, bare
        self._endpoint = FirmwareEndpoint(name="r1", program="benchmark", boot=os.getpid())
        self._period_ns = round(1e9 / rate)
        self._sent: list[int] = []
        self._bare_sent: list[int] = []
        self._corrected: dict[int, int] = {}
        self._bare_corrected: dict[int, int] = {}

    def run(self) -> None:
        """Until a line comes on standard input; then all times go to standard output."""
        os.write(self._ours, self._endpoint.hello())
        due_ns = time.monotonic_ns()
        while True:
            wait_s = min(max(0.0, (due_ns - time.monotonic_ns()) / 1e9), _LONGEST_WAIT_S)
            ready, _, _ = select.select([self._ours, self._bare, 0], [], [], wait_s)
            if 0 in ready:
                break
            self._receive(ready)
            if time.monotonic_ns() >= due_ns:
                self._send()
                due_ns += self._period_ns // 2
        times = (self._sent, self._bare_sent, self._corrected, self._bare_corrected)
        print(json.dumps(times), flush=True)

    def _receive(self, ready: list[int]) -> None:
        if self._ours in ready:
            data = os.read(self._ours, 4096)
            now_ns = time.monotonic_ns()
            os.write(self._ours, self._endpoint.receive(data, now_ns))
            self._corrected |= {one.sequence: now_ns for one in self._endpoint.applied}
            self._endpoint.applied.clear()
        if self._bare in ready:
            data = os.read(self._bare, 4096)
            now_ns = time.monotonic_ns()
            for begin in range(0, len(data), FRAME):
                self._bare_corrected[int(data[begin : begin + FRAME])] = now_ns

    def _send(self) -> None:
        now_ns, count = time.monotonic_ns(), len(self._sent)
        if count > len(self._bare_sent):
            self._bare_sent.append(now_ns)
            os.write(self._bare, b"%0*d" % (FRAME, count - 1))
            return
        pose, still = Pose.planar(STEP_M * count, 0, 0), np.zeros(3)
        frame = self._endpoint.odometry(now_ns, pose, still, still)
        self._sent.append(time.monotonic_ns())
        os.write(self._ours, frame + self._endpoint.heartbeat(now_ns))


def bare_bridge(port: str, endpoint: str) -> None:
    """Put every frame that comes on the bus, and every sample on the line; nothing else."""
    descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY)

    def write(sample: zenoh.Sample) -> None:
        os.write(descriptor, sample.payload.to_bytes())

    with (
        open_bare(connect=endpoint) as session,
        session.declare_publisher(BARE_ODOMETRY) as publisher,
        session.declare_subscriber(BARE_CORRECTION, zenoh.handlers.Callback(write, indirect=False)),
    ):
        held = b""
        while True:
            select.select([descriptor], [], [])
            held += os.read(descriptor, 4096)
            while len(held) >= FRAME:
                publisher.put(held[:FRAME])
                held = held[FRAME:]


if __name__ == "__main__":
    role, *words = sys.argv[1:]
    if role == "robot":
        Robot(int(words[0]), int(words[1]), float(words[2])).run()
    else:
        bare_bridge(*words)
