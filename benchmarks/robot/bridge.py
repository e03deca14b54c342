"""The robot bridge as a program between a pseudo-terminal and the bus: how late, dear and lossy.

    python -m benchmarks.robot.bridge [--rate 50] [--seconds 30] [--unplugs 100]

A robot sends readings by turns on two lines: to `trigpoint robot`, and to a bare loop that puts
every frame on the bus with Zenoh alone (`robot_line_ends`). Both are programs of their own, and so
is the robot; what comes of both is taken by one session here. So what the machine costs, which has
other things to do, is in both. Or the line is unplugged and plugged in again under the same name.
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
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

import numpy as np
import zenoh

from benchmarks.network.bus_wire import free_endpoint
from trigpoint.bus.bus import Bus
from trigpoint.bus.settings import Settings
from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import Diagnostics, Odometry, PoseEstimate
from trigpoint.contract.topics import CORRECTION, DIAGNOSTICS, ODOMETRY
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.robot.firmware.endpoint import FirmwareEndpoint
from trigpoint.robot.node import RobotNode
from trigpoint.site.config import parse_site
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.zenoh import open_session

from .line_ends import BARE_CORRECTION, BARE_ODOMETRY, FRAME, STEP_M

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
Told = tuple[list[int], list[int], dict[str, int], dict[str, int]]
"""What the robot wrote on both lines, when; which corrections it got on both, when."""
_START_S = 30.0
_CORRECT_EVERY_S = 0.1


@dataclass(slots=True)
class Ear:
    """What comes to the session here: (monotonic clock, payload) of each sample, by key."""

    heard: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)

    def hear(self, sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        self.heard.setdefault(str(sample.key_expr), []).append((now_ns, sample.payload.to_bytes()))

    def of(self, key: str) -> list[tuple[int, bytes]]:
        return self.heard.get(key, [])


def measured(rate: float, seconds: float) -> "tuple[Run, Told]":
    """Drive both lines; what came of it, and what the robot wrote and got."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = free_endpoint()
        (folder / "site.toml").write_text(f'{SITE}[bus]\nconnect = ["{endpoint}"]\n')
        lines = [os.openpty() for _ in range(2)]
        for _, theirs in lines:
            tty.setraw(theirs)
        ours, bare = (os.ttyname(theirs) for _, theirs in lines)
        (folder / "r1.port").symlink_to(ours)
        session = stack.enter_context(open_session(Settings("peer", listen=(endpoint,))))
        ear, callback = Ear(), zenoh.handlers.Callback
        for key in (ODOMETRY.key("lab", "r1"), BARE_ODOMETRY, DIAGNOSTICS.key("lab")):
            stack.enter_context(session.declare_subscriber(key, callback(ear.hear, indirect=False)))
        answer = json.dumps({"map_id": str(MAP)})
        stack.enter_context(
            session.declare_queryable(
                "lab/fusion/map", lambda query: query.reply("lab/fusion/map", answer)
            )
        )
        module = [sys.executable, "-m"]
        ends = [*module, "benchmarks.robot.line_ends"]
        bridge = ["trigpoint", "robot", "--site", str(folder / "site.toml"), "--robot", "r1"]
        programs = [
            started(stack, words) for words in ([*module, *bridge], [*ends, "bare", bare, endpoint])
        ]
        masters = [master for master, _ in lines]
        sender = stack.enter_context(
            subprocess.Popen(
                [*ends, "robot", *map(str, masters), str(rate)], pass_fds=masters, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )
        )  # fmt: skip
        stack.callback(sender.kill)
        run = Run(session, ear, [program.pid for program in programs])
        run.wait()
        run.run(seconds)
        assert sender.stdin is not None
        out, _ = sender.communicate("\n", timeout=10)
    return run, json.loads(out)


def started(stack: ExitStack, words: list[str]) -> subprocess.Popen[bytes]:
    """A program that is ended with the stack."""
    process = stack.enter_context(subprocess.Popen(words))
    stack.callback(process.terminate)
    return process


class Run:
    """Corrections ten times a second for a while, and what came of it all. `pids`: of our bridge
    and of the bare one."""

    def __init__(self, session: zenoh.Session, ear: Ear, pids: list[int]) -> None:
        self._ear, self._pids = ear, pids
        self._key = ODOMETRY.key("lab", "r1")
        urgent = {
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "priority": zenoh.Priority.REAL_TIME,
            "express": True,
        }
        self._ours = session.declare_publisher(
            CORRECTION.key("lab", "r1"), encoding=CORRECTION.encoding, **urgent
        )
        self._bare = session.declare_publisher(BARE_CORRECTION, **urgent)
        self._corrected_ns = 0
        self._put: dict[int, int] = {}
        self._bare_put: dict[int, int] = {}
        self._window_ns = (0, 0)
        self._spent_s = [0.0, 0.0]

    def wait(self) -> None:
        """Until both lines have brought something."""
        deadline = time.monotonic() + _START_S
        while not (self._ear.of(self._key) and self._ear.of(BARE_ODOMETRY)):
            if time.monotonic() > deadline:
                raise RuntimeError("the bridges did not start")
            time.sleep(0.05)
        time.sleep(1.0)

    def run(self, seconds: float) -> None:
        """Send corrections by turns."""
        begin_s, before_s = time.monotonic(), [spent_s(pid) for pid in self._pids]
        for number in range(1, round(seconds / _CORRECT_EVERY_S) + 1):
            time.sleep(max(0.0, begin_s + number * _CORRECT_EVERY_S - time.monotonic()))
            self._correct(number)
            time.sleep(_CORRECT_EVERY_S / 2)
            self._bare_put[number] = time.monotonic_ns()
            self._bare.put(b"%0*d" % (FRAME, number))
        self._window_ns = (round(begin_s * 1e9), time.monotonic_ns())
        self._spent_s = [spent_s(pid) - s for pid, s in zip(self._pids, before_s, strict=True)]
        time.sleep(0.5)

    def _correct(self, number: int) -> None:
        at = decode(ODOMETRY.type_name, self._ear.of(self._key)[-2][1])
        assert isinstance(at, Odometry)
        if at.stamp_ns <= self._corrected_ns:
            return  # nothing new came since the last one
        self._corrected_ns = at.stamp_ns
        estimate = PoseEstimate(at.stamp_ns, "map", at.pose, np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4]))
        payload, mark = encode(estimate), encode_mark(CorrectionMark(MAP, number))
        self._put[number] = time.monotonic_ns()
        self._ours.put(payload, attachment=mark)

    def correction_ms(self, told: Told) -> np.ndarray:
        """From put on the bus to bytes at the robot, of each correction that got there."""
        return _ways(self._put, told[2])

    def report(self, rate: float, told: Told) -> None:
        """Print how late odometry and corrections are, what it costs, and what is lost."""
        sent, bare_sent, _, bare_got = told
        came = {_reading(payload): at for at, payload in self._ear.of(self._key)}
        bare_came = {int(payload): at for at, payload in self._ear.of(BARE_ODOMETRY)}
        elapsed_s = (self._window_ns[1] - self._window_ns[0]) / 1e9
        ours, lost = self._late(sent, came)
        bare, bare_lost = self._late(bare_sent, bare_came)
        print(f"{rate:g} readings a second for {elapsed_s:.0f} s, beside a bare loop:")
        print(f"  lost: {lost} of {len(ours) + lost} (bare: {bare_lost})")
        print(f"  bytes at the port to a subscriber's callback, ms: {beside(ours, bare)}")
        way = self.correction_ms(told)
        bare_way = _ways(self._bare_put, bare_got)
        print(f"  correction put to bytes at the robot, ms: {beside(way, bare_way)}")
        print(
            f"    {len(way)} of {len(self._put)} corrections got there (the first place the robot)"
        )
        cores = [100 * s / elapsed_s for s in self._spent_s]
        each_us = [1e6 * s / max(len(ours), 1) for s in self._spent_s]
        print(
            f"  processor: {cores[0]:.1f} % of a core (bare: {cores[1]:.1f}), "
            f"{each_us[0]:.0f} µs a reading with all else (bare: {each_us[1]:.0f})"
        )
        print(f"  the bridge counted as lost: {self._losses() or 'nothing'}")

    def _late(self, sent: list[int], came: dict[int, int]) -> tuple[np.ndarray, int]:
        """(lateness in ms, how many never came) of what was sent within the window."""
        begin_ns, end_ns = self._window_ns
        within = {k: at for k, at in enumerate(sent) if begin_ns <= at < end_ns}
        late = [(came[k] - at) / 1e6 for k, at in within.items() if k in came]
        return np.array(late), len(within) - len(late)

    def _losses(self) -> str:
        """What the bridge itself counted as lost, by its last word."""
        for _, payload in reversed(self._ear.of(DIAGNOSTICS.key("lab"))):
            message = decode(DIAGNOSTICS.type_name, payload)
            assert isinstance(message, Diagnostics)
            for status in message.statuses:
                lost = {n: v for n, v in status.values.items() if n.endswith(".lost") and v != "0"}
                return ", ".join(f"{v} {n.removesuffix('.lost')}" for n, v in lost.items())
        return ""


def _reading(payload: bytes) -> int:
    message = decode(ODOMETRY.type_name, payload)
    assert isinstance(message, Odometry)
    return round(float(message.pose.translation[0]) / STEP_M)


def _ways(put: dict[int, int], got: dict[str, int]) -> np.ndarray:
    return np.array([(got[str(k)] - at) / 1e6 for k, at in put.items() if str(k) in got])


def spent_s(pid: int) -> float:
    """Processor time of a process's threads so far."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9


def beside(ours: np.ndarray, bare: np.ndarray) -> str:
    marks = [np.percentile(values, [50, 99]) for values in (ours, bare)]
    texts = ["p50 {:.2f}, p99 {:.2f}".format(*mark) for mark in marks]
    more = marks[0] - marks[1]
    return f"{texts[0]} (bare: {texts[1]}; ours adds {more[0]:.2f}, {more[1]:.2f})"


class Desk:
    """The site in a folder, its bus and its bridge."""

    def __init__(self, stack: ExitStack) -> None:
        self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self.link = self.folder / "r1.port"
        self.site = parse_site(SITE, directory=self.folder)
        broker = MemoryBroker()
        self.bus: Bus = stack.enter_context(broker.session())
        self.odometry = self.bus.subscribe(ODOMETRY, ODOMETRY.key("lab", "r1"))
        self._stack, self._broker = stack, broker

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


def robot(descriptor: int, boot: int, stopping: threading.Event) -> None:
    """A firmware that sends 50 readings a second; its clock is this machine's monotonic one."""
    endpoint = FirmwareEndpoint(name="r1", program="benchmark", boot=boot)
    os.write(descriptor, endpoint.hello())
    due_ns, sent = time.monotonic_ns(), 0
    while not stopping.is_set():
        wait_s = min(max(0.0, (due_ns - time.monotonic_ns()) / 1e9), 0.05)
        ready, _, _ = select.select([descriptor], [], [], wait_s)
        with suppress(OSError):
            if ready:
                data = os.read(descriptor, 4096)
                os.write(descriptor, endpoint.receive(data, time.monotonic_ns()))
            now_ns = time.monotonic_ns()
            os.write(descriptor, endpoint.heartbeat(now_ns))
            if now_ns >= due_ns:
                pose, still = Pose.planar(STEP_M * sent, 0, 0), np.zeros(3)
                os.write(descriptor, endpoint.odometry(now_ns, pose, still, still))
                sent += 1
                due_ns += 20_000_000


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
            thread = threading.Thread(target=robot, args=(ours, number, stopping))
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
    arguments = parser.parse_args()
    if arguments.unplugs:
        unplugged(arguments.unplugs)
    else:
        run, told = measured(arguments.rate, arguments.seconds)
        run.report(arguments.rate, told)


if __name__ == "__main__":
    main()
