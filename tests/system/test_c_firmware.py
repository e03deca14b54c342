"""The firmware's side in C99: its frames those of docs/reference/serial.md, driven over a pty."""

import json
import os
import shutil
import subprocess
import tty
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from support.builders import eventually

from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import Odometry, PoseEstimate
from trigpoint.contract.topics import CORRECTION, ODOMETRY
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.robot.line.protocols.framing import Frame, decode_frame
from trigpoint.robot.line.protocols.trigpoint_frames import (
    Acknowledge,
    Content,
    OdometryFrame,
    Pong,
    decode_payload,
)
from trigpoint.robot.node import RobotNode
from trigpoint.site.config import parse_site
from trigpoint.testing.memory_bus import MemoryBroker

HERE = Path(__file__).parents[1] / "firmware"
HEADER = Path(__file__).parents[2] / "robot" / "firmware"
MAP = UUID(int=7)
COMPILER = shutil.which("gcc") or shutil.which("cc")
STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsanitize=undefined")

pytestmark = pytest.mark.skipif(COMPILER is None, reason="this machine has no C compiler")


def compiled(source: str, folder: Path) -> Path:
    program = folder / Path(source).stem
    words = [str(COMPILER), *STRICT, f"-I{HEADER}", str(HERE / source), "-lm", "-o", str(program)]
    subprocess.run(words, check=True, timeout=60)
    return program


def content(digits: str) -> Content:
    frame = decode_frame(bytes.fromhex(digits)[:-1])
    assert isinstance(frame, Frame)
    return decode_payload(frame.kind, frame.payload)


def test_frames_are_those_of_the_document(tmp_path: Path) -> None:
    document = (Path(__file__).parents[2] / "docs" / "reference" / "serial.md").read_text("utf-8")

    def example(name: str) -> str:
        return "".join(document.split(f"```{name}\n")[1].split("```")[0].split())

    heard = "".join(example(name) for name in ("hello", "ping", "correction", "correction"))
    said = subprocess.run(
        [compiled("examples.c", tmp_path)], input=heard,
        capture_output=True, text=True, check=True, timeout=60,
    ).stdout.splitlines()  # fmt: skip
    assert [*said[:2], said[3]] == ["00", example("hello"), example("ticks")]
    ours, documented = content(said[2]), content(example("odometry"))
    assert isinstance(ours, OdometryFrame)  # to the last bit but for the cosine's rounding
    assert isinstance(documented, OdometryFrame)
    np.testing.assert_allclose(ours.pose.difference(documented.pose), 0, atol=1e-15)
    assert (ours.boot, ours.stamp_ns) == (documented.boot, documented.stamp_ns)
    assert (*ours.linear, *ours.angular) == (*documented.linear, *documented.angular)
    contents = [content(line) for line in said[4:-1]]
    assert contents[1] == Pong(3, 0x12345678, 2_500_100_000, 2_500_100_000)
    # The correction's moment is that of the reading; sent twice it is answered twice alike.
    assert contents[2:] == [Acknowledge(41, 0, "")] * 2
    assert said[-1] == "received 4 rejected 0"


def test_sketch_compiles(tmp_path: Path) -> None:
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("this machine has no C++ compiler")
    source = HEADER / "rover" / "rover.ino"
    words = [
        compiler, "-x", "c++", "-std=c++11", "-Wall", "-Wextra", "-Werror", "-include",
        str(HERE / "stub" / "Arduino.h"), f"-I{HEADER}", "-c", str(source), "-o",
        str(tmp_path / "rover.o"),
    ]  # fmt: skip
    subprocess.run(words, check=True, timeout=60)


@dataclass
class Rover:
    """The C robot in a process of its own, behind a pty."""

    folder: Path
    program: Path
    stack: ExitStack
    broker: MemoryBroker = field(default_factory=MemoryBroker)
    lines: Path = field(init=False)

    def __post_init__(self) -> None:
        self.lines = self.folder / "corrections.txt"
        self.ours, self.theirs = os.openpty()
        tty.setraw(self.theirs)
        for descriptor in (self.ours, self.theirs):
            self.stack.callback(os.close, descriptor)
        port = os.ttyname(self.theirs)
        text = (
            'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "sim://c1"\n'
            f'[robots.r1]\nport = "{port}"\n'
        )
        self.site = parse_site(text, directory=self.folder)
        self.bus = self.stack.enter_context(self.broker.session())
        self.odometry = self.bus.subscribe(ODOMETRY, ODOMETRY.key("lab", "r1"))
        self.sequence = 0

    def start(self, boot: int, kind: str) -> None:
        words = [str(self.program), str(self.ours), str(boot), kind]
        with self.lines.open("ab") as out:
            process = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=out, pass_fds=[self.ours]
            )
        self.stack.callback(process.wait, 60)
        assert process.stdin is not None
        self.stack.callback(process.stdin.close)

    def run_bridge(self, corrections: int) -> Odometry:
        """A bridge until it was told so many corrections; the last odometry."""
        answer = json.dumps({"map_id": str(MAP)}).encode()
        with (
            closing(self.broker.session()) as bus,
            Node(bus, site="lab", kind="robot", name="r1") as node,
            closing(self.bus.serve("lab/fusion/map", lambda _: answer)),
        ):
            RobotNode(bus, node, self.site, "r1").start()
            held: list[Odometry] = []

            def is_told() -> bool:
                sample = self.odometry.take(1.0)
                if sample is not None:
                    message = decode(ODOMETRY.type_name, sample.payload)
                    assert isinstance(message, Odometry)
                    held.append(message)
                    if len(held) % 5 == 0:
                        self._correct(held[-3])
                return node.health.total("corrections_accepted") >= corrections

            assert eventually(is_told), node.health.report().values
            assert not node.health.lost("serial_checksum_errors")
            assert not node.health.lost("corrections_unanswered")
            return held[-1]

    def _correct(self, at: Odometry) -> None:
        self.sequence += 1
        publisher = self.bus.publisher(CORRECTION, CORRECTION.key("lab", "r1"))
        pose = Pose.planar(10.0, 3.0, 1.0) @ at.pose
        estimate = PoseEstimate(at.stamp_ns, "map", pose, np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4]))
        mark = CorrectionMark(MAP, self.sequence)
        publisher.put(encode(estimate), attachment=encode_mark(mark))

    @property
    def told(self) -> list[list[float]]:
        """What the firmware applied: number, establishes, x, y, heading, xx."""
        return [[float(word) for word in line.split()] for line in self.lines.open()]


@pytest.fixture
def rover(tmp_path: Path) -> Iterator[Rover]:
    with ExitStack() as stack:
        yield Rover(tmp_path, compiled("rover.c", tmp_path), stack)


@pytest.mark.parametrize("kind", ["odometry", "ticks"])
def test_robot_in_c_drives_and_is_corrected_also_by_a_restarted_bridge(
    rover: Rover, kind: str
) -> None:
    rover.start(77, kind)
    rover.run_bridge(5)
    first = rover.told
    assert len(first) >= 5
    assert [row[1] for row in first] == [1] + [0] * (len(first) - 1)
    last = rover.run_bridge(5)
    # The circle of 0.4 / 0.3 m about (0, 4/3); counts are cut to a tenth of a millimetre.
    offset = last.pose.translation[:2] - [0.0, 4 / 3]
    assert np.linalg.norm(offset) == pytest.approx(4 / 3, abs=0.01)
    again = rover.told[len(first) :]
    assert len(again) >= 5
    # A firmware that applies no number twice took all of the second bridge's.
    assert min(row[0] for row in again) > max(row[0] for row in first)
    assert [row[1] for row in again] == [1] + [0] * (len(again) - 1)
    assert [np.sqrt(row[5]) for row in again] == pytest.approx([0.01] * len(again), rel=0.1)
