"""A site in a folder with a simulated robot in a process of its own, on a pseudo-terminal."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from support.builders import eventually

from trigpoint.base.clock import to_ns
from trigpoint.bus.bus import Subscription
from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import Odometry, PoseEstimate
from trigpoint.contract.topics import CORRECTION, ODOMETRY
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.robot.node import RobotNode
from trigpoint.site.config import Site, parse_site
from trigpoint.testing.memory_bus import MemoryBroker

SITE = """\
site = "lab"
target = "target.toml"
[cameras.c1]
source = "sim://c1"
[robots.r1]
port = "./r1.port"
"""
MAP = UUID(int=7)
PERIOD_NS = to_ns(0.02)


class Desk:
    """A site in a folder, its simulated robot, and a bus that lives as long."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self._stack = folder, stack
        (folder / "site.toml").write_text(SITE)
        self.site: Site = parse_site(SITE, directory=folder)
        self.port, self.journal = folder / "r1.port", folder / "r1.jsonl"
        self.epoch_ns = time.time_ns() - to_ns(20.0)
        self.broker = MemoryBroker()
        self.bus = stack.enter_context(self.broker.session())
        self.odometry: Subscription = self.bus.subscribe(
            ODOMETRY, ODOMETRY.key(self.site.name, "r1")
        )
        self.sequence = 0

    def start_firmware(self, *more: str) -> subprocess.Popen[bytes]:
        options = {
            "--world": "lab", "--seed": "1", "--epoch-ns": str(self.epoch_ns), "--robot": "r1",
            "--link": str(self.port), "--log": str(self.journal),
        }  # fmt: skip
        words = [word for pair in options.items() for word in pair]
        module = "trigpoint.tools.simulation.serial.firmware"
        process = subprocess.Popen([sys.executable, "-m", module, *words, *more])
        self._stack.callback(end, process)
        assert eventually(lambda: self.port.exists())
        return process

    @contextmanager
    def bridge(self) -> Iterator[Node]:
        bus = self.broker.session()
        with closing(bus), Node(bus, site=self.site.name, kind="robot", name="r1") as node:
            RobotNode(bus, node, self.site, "r1").start()
            yield node

    def take(self, count: int) -> list[Odometry]:
        """The next messages; fails where they do not come."""
        found = []
        for _ in range(count):
            sample = self.odometry.take(60.0)
            assert sample is not None, "no odometry came"
            message = decode(ODOMETRY.type_name, sample.payload)
            assert isinstance(message, Odometry)
            found.append(message)
        return found

    def rest(self) -> list[Odometry]:
        """What still comes, until nothing more does."""
        found = []
        while (sample := self.odometry.take(0.5)) is not None:
            message = decode(ODOMETRY.type_name, sample.payload)
            assert isinstance(message, Odometry)
            found.append(message)
        return found

    def correct(self, at: Odometry, pose: Pose) -> None:
        self.sequence += 1
        publisher = self.bus.publisher(CORRECTION, CORRECTION.key(self.site.name, "r1"))
        covariance = np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4])
        payload = encode(PoseEstimate(at.stamp_ns, "map", pose, covariance))
        publisher.put(payload, attachment=encode_mark(CorrectionMark(MAP, self.sequence)))

    def place(self, node: Node, map_from_odom: Pose) -> None:
        """Correct the robot as it drives, with fusion's word, until it was told where it is."""
        answer = json.dumps({"map_id": str(MAP)}).encode()
        with closing(self.bus.serve(f"{self.site.name}/fusion/map", lambda _: answer)):

            def is_placed() -> bool:
                message = self.take(8)[-6]
                self.correct(message, map_from_odom @ message.pose)
                return node.health.total("corrections_accepted") > 0

            assert eventually(is_placed)

    def noted(self, kind: str) -> list[dict]:
        """What the robot wrote down."""
        lines = self.journal.read_text("utf-8").splitlines()
        return [note for line in lines if (note := json.loads(line))["kind"] == kind]


def end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.wait(60.0)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(tmp_path, stack)
