"""The robot bridge as a node between a pseudo-terminal and a bus: how late, how dear, how lossy.

    python -m benchmarks.robot_bridge [--rate 50] [--seconds 30] [--unplugs 100]

The robot is a process of its own that stamps its readings as it writes them; the bridge's node runs
here on a bus in memory, so that Zenoh's share is not in it. Or the line is unplugged and plugged in
again under the same name. Processor time is that of the node's threads.
"""

import argparse
import json
import os
import select
import subprocess
import sys
import tempfile
import threading
import time
import tty
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from uuid import UUID

import numpy as np

from trigpoint.bus import Bus
from trigpoint.bus_memory import MemoryBroker
from trigpoint.cdr import decode, encode
from trigpoint.config import parse_site
from trigpoint.correction import CorrectionMark, encode_mark
from trigpoint.geometry import Pose
from trigpoint.messages import Odometry, PoseEstimate
from trigpoint.node import Node
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.node import RobotNode
from trigpoint.topics import CORRECTION, ODOMETRY

MAP = UUID(int=7)
SITE = """\
site = "lab"
target = "target.toml"
[cameras.c1]
source = "sim://c1"
[robots.r1]
port = "./r1.port"
baud = 921600
[robots.r1.safety]
establish_motion = 0.0
"""


def robot(descriptor: int, rate: float, boot: int, stopping: threading.Event | None = None) -> None:
    """A firmware whose clock is this machine's monotonic one; says on standard output when each
    correction's bytes had come, and at the end how many readings it sent."""
    endpoint = FirmwareEndpoint(name="r1", program="benchmark", boot=boot)
    os.write(descriptor, endpoint.hello())
    due_ns, period_ns, sent = time.monotonic_ns(), round(1e9 / rate), 0
    while stopping is None or not stopping.is_set():
        timeout_s = max(0.0, (due_ns - time.monotonic_ns()) / 1e9)
        ends: list[int] = [descriptor] if stopping else [descriptor, 0]
        ready, _, _ = select.select(ends, [], [], min(timeout_s, 0.05))
        if 0 in ready:
            break
        with suppress(OSError):
            if descriptor in ready:
                os.write(
                    descriptor, endpoint.receive(os.read(descriptor, 4096), time.monotonic_ns())
                )
            now_ns = time.monotonic_ns()
            for applied in endpoint.applied:
                if stopping is None:
                    print(f"{applied.sequence} {now_ns}", flush=True)
            endpoint.applied.clear()
            os.write(descriptor, endpoint.heartbeat(now_ns))
            if now_ns >= due_ns:
                pose = Pose.planar(1e-4 * sent, 0, 0)
                stamp_ns = time.monotonic_ns()
                os.write(descriptor, endpoint.odometry(stamp_ns, pose, np.zeros(3), np.zeros(3)))
                sent += 1
                due_ns += period_ns
    if stopping is None:
        print(f"sent {sent}", flush=True)


class Desk:
    """The site in a folder, its bus and its bridge."""

    def __init__(self, stack: ExitStack) -> None:
        self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self.link = self.folder / "r1.port"
        self.site = parse_site(SITE, directory=self.folder)
        broker = MemoryBroker()
        self.bus: Bus = stack.enter_context(broker.session())
        self.odometry = self.bus.subscribe(ODOMETRY, ODOMETRY.key("lab", "r1"))
        self.corrections = self.bus.publisher(CORRECTION, CORRECTION.key("lab", "r1"))
        answer = json.dumps({"map_id": str(MAP)}).encode()
        stack.enter_context(closing(self.bus.serve("lab/fusion/map", lambda _: answer)))
        self._stack, self._broker = stack, broker
        self.sequence = 0

    def start(self) -> Node:
        bus = self._stack.enter_context(self._broker.session())
        node = self._stack.enter_context(Node(bus, site="lab", kind="robot", name="r1"))
        RobotNode(bus, node, self.site, "r1").start()
        return node

    def take(self, timeout_s: float) -> tuple[Odometry, int] | None:
        sample = self.odometry.take(timeout_s)
        if sample is None:
            return None
        message = decode(ODOMETRY.type_name, sample.payload)
        assert isinstance(message, Odometry)
        return message, sample.received_ns

    def correct(self, at: Odometry) -> tuple[int, int]:
        """(number, when it was put on the bus)."""
        self.sequence += 1
        covariance = np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4])
        payload = encode(PoseEstimate(at.stamp_ns, "map", at.pose, covariance))
        begin_ns = time.monotonic_ns()
        mark = encode_mark(CorrectionMark(MAP, self.sequence))
        self.corrections.put(payload, attachment=mark)
        return self.sequence, begin_ns


def measured(rate: float, seconds: float) -> None:
    """Print how late odometry and corrections are, what it costs, and what is lost."""
    with ExitStack() as stack:
        desk = Desk(stack)
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        desk.link.symlink_to(os.ttyname(theirs))
        words = [sys.executable, "-m", "benchmarks.robot_bridge", "--robot", str(ours)]
        process = subprocess.Popen(
            [*words, "--rate", str(rate)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            pass_fds=[ours], text=True,
        )  # fmt: skip
        node = desk.start()
        late, put, received = [], {}, 0
        while (first := desk.take(10.0)) is None:
            pass
        begin_s, begin_cpu_s = time.monotonic(), bridge_seconds()
        held = [first[0]]
        while time.monotonic() < begin_s + seconds:
            taken = desk.take(1.0)
            if taken is None:
                continue
            message, arrived_ns = taken
            received += 1
            late.append((arrived_ns - message.stamp_ns) / 1e6)
            held = [*held[-4:], message]
            if received % max(1, round(rate / 10)) == 0:
                number, begin_ns = desk.correct(held[-2])
                put[number] = begin_ns
        elapsed_s = time.monotonic() - begin_s
        cores = (bridge_seconds() - begin_cpu_s) / elapsed_s
        missing = node.health.lost("serial_frames_missing")
        assert process.stdin is not None
        out, _ = process.communicate("\n", timeout=10)
    lines = [line.split() for line in out.splitlines()]
    told = {int(number): int(at) for number, at in lines if number != "sent"}
    way = np.array([(told[k] - put[k]) / 1e6 for k in put if k in told])
    print(f"{rate:g} readings a second for {elapsed_s:.0f} s: {received} received, {missing} lost")
    print(f"  written to bus, ms: {percentiles(np.array(late))}")
    print(
        f"  correction put to bytes read by the robot, ms: {percentiles(way)} ({len(way)} of them)"
    )
    print(f"  the bridge's threads take {100 * cores:.1f} % of a core")


def bridge_seconds() -> float:
    """Processor time of the node's own threads so far."""
    total_ns = 0
    for thread in threading.enumerate():
        if thread.name.startswith("robot/r1"):
            text = Path(f"/proc/self/task/{thread.native_id}/schedstat").read_text()
            total_ns += int(text.split()[0])
    return total_ns / 1e9


def percentiles(values: np.ndarray) -> str:
    marks = np.percentile(values, [50, 99, 99.9])
    return "p50 {:.2f}, p99 {:.2f}, p99.9 {:.2f}".format(*marks)


def unplugged(times: int) -> None:
    """Print how soon odometry goes on after the line comes back, and whether its pose does."""
    with ExitStack() as stack:
        desk = Desk(stack)
        back_s, steps, last = [], [], None
        for number in range(times + 1):
            ours, theirs = os.openpty()
            tty.setraw(theirs)
            plugged_s = time.monotonic()
            desk.link.symlink_to(os.ttyname(theirs))
            stopping = threading.Event()
            thread = threading.Thread(target=robot, args=(ours, 50.0, number, stopping))
            thread.start()
            if number == 0:
                desk.start()
            while (taken := desk.take(10.0)) is not None:
                if last is None or taken[0].stamp_ns > last.stamp_ns:
                    break
            if taken is None:
                raise RuntimeError("the odometry did not come back")
            if last is not None:
                back_s.append(time.monotonic() - plugged_s)
                steps.append(float(np.abs(taken[0].pose.difference(last.pose)).max()))
            last = taken[0]
            desk.link.unlink()
            stopping.set()
            thread.join()
            os.close(ours)
            os.close(theirs)
            while (taken := desk.take(0.3)) is not None:
                last = taken[0]
    print(
        f"unplugged {times} times: back after {np.median(back_s):.2f} s, at most "
        f"{max(back_s):.2f} s; largest step of the pose {max(steps):.4f} m or rad"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--unplugs", type=int, default=0)
    parser.add_argument("--robot", type=int, default=-1, help="run the robot on this descriptor")
    arguments = parser.parse_args()
    if arguments.robot >= 0:
        robot(arguments.robot, arguments.rate, boot=os.getpid())
    elif arguments.unplugs:
        unplugged(arguments.unplugs)
    else:
        measured(arguments.rate, arguments.seconds)


if __name__ == "__main__":
    main()
