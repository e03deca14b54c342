"""Every part's working threads feed the service manager's watchdog themselves, and nothing else
does: a part whose work hangs tells the manager nothing more, and says what hangs.

The watchdog has a clock of its own here. Once that is set forward every thread is overdue, and only
those that still work say so anew.
"""

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.builders import TARGET_TEXT, eventually, site_text, told

from trigpoint.base.clock import ManualClock, SystemClock
from trigpoint.base.errors import PortError
from trigpoint.contract import topics
from trigpoint.fusion.inputs import load_inputs
from trigpoint.fusion.live.solver_process import SolverProcess
from trigpoint.fusion.node import FusionNode
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.node.node import Node
from trigpoint.node.watchdog import SOCKET, Watchdog
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.recorder.node import Recorder
from trigpoint.recorder.writing.sink import McapSink
from trigpoint.robot.corrections import Corrections
from trigpoint.robot.line.port import Port
from trigpoint.robot.node import RobotNode
from trigpoint.site.config import Site, load_site
from trigpoint.testing.memory_bus import MemoryBroker

LATER_S = 1000.0
TICK_S = 0.05
PATIENCES_S = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


class Brake:
    """Work that goes on, or hangs."""

    def __init__(self) -> None:
        self._is_off = threading.Event()
        self._is_off.set()

    def before(self, work: Callable) -> Callable:
        """The work, once the brake is off."""

        def braked(*arguments: object, **named: object) -> object:
            self._is_off.wait(60.0)
            return work(*arguments, **named)

        return braked

    def pull(self) -> None:
        self._is_off.clear()

    def release(self) -> None:
        self._is_off.set()


class Desk:
    """One part on a bus, and the manager that watches it."""

    def __init__(self, folder: Path, manager: socket.socket, stack: ExitStack) -> None:
        (folder / "site.toml").write_text(site_text())
        (folder / "target.toml").write_text(TARGET_TEXT)
        self.site: Site = load_site(folder / "site.toml")
        self.manager, self.clock, self.brake = manager, ManualClock(), Brake()
        self.watchdog = Watchdog({SOCKET: manager.getsockname()}, self.clock)
        self._stack, self._folder = stack, folder
        broker = MemoryBroker()
        self.bus, self.other = (stack.enter_context(broker.session()) for _ in range(2))

    def _node(self, kind: str, name: str) -> Node:
        watchdog = self.watchdog
        return Node(self.bus, site="lab", kind=kind, name=name, watchdog=watchdog, period_s=TICK_S)

    def start_robot(self) -> None:
        node = self._stack.enter_context(self._node("robot", "r1"))
        self._stack.callback(self.brake.release)
        RobotNode(self.bus, node, self.site, "r1").start()

    def start_fusion(self) -> SolverProcess:
        node = self._node("fusion", "fusion")
        inputs = load_inputs(self.site, network=None)
        pulse = self.watchdog.pulse(f"{node.label} solves", within_s=1.0)
        solver = SolverProcess(inputs.data_set(), pulse)
        self._stack.callback(solver.close)
        self._stack.enter_context(node)
        self._stack.callback(self.brake.release)
        clock = SystemClock()
        FusionNode(self.bus, node, inputs, self._folder, clock, solver=lambda _: solver).start()
        return solver

    def start_recorder(self) -> None:
        recorder = self._stack.enter_context(Recorder(self.site, self._folder / "s.mcap"))
        node = self._stack.enter_context(self._node("recorder", "main"))
        self._stack.callback(self.brake.release)
        recorder.start(self.bus, node)

    def is_watched_well(self) -> bool:
        """Whether the manager is told again after all had to say so anew."""
        self.clock.advance(LATER_S)
        said: list[str] = []
        # The first may have been on its way when the clock was set.
        return eventually(lambda: bool(said.extend(self._told()) or len(said) > 1), timeout_s=200.0)

    def is_silenced_by(self, name: str) -> bool:
        """Whether the manager is told nothing any more for the sake of one thread. Its last sign
        may have been on its way, or its next work still ahead, when the clock was set; on a busy
        machine the others take longer for theirs."""
        return any(self._stays_alone_overdue(name, within_s) for within_s in PATIENCES_S)

    def _stays_alone_overdue(self, name: str, within_s: float) -> bool:
        self.clock.advance(LATER_S)
        if not eventually(lambda: not self._told() and self.watchdog.hung == (name,), within_s):
            return False
        self._told()
        time.sleep(0.5)  # more than a turn of any thread
        return not self._told() and self.watchdog.hung == (name,)

    def _told(self) -> list[str]:
        return told(self.manager)


@pytest.fixture(autouse=True)
def turns_are_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread says that it works once a turn, and some turn but every fifteen seconds."""
    for turn in (
        "fusion.live.coverage_thread.PERIOD_S",
        "recorder.node._NETWORK_PERIOD_S",
        "node.clock_watch._ASK_EVERY_S",
        "robot.relocation._ASK_EVERY_S",
    ):
        monkeypatch.setattr(f"trigpoint.{turn}", TICK_S)


@pytest.fixture
def desk(tmp_path: Path, manager: socket.socket) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(tmp_path, manager, stack)


@pytest.mark.parametrize(
    ("work", "what"),
    [("read", "reads"), ("write", "writes")],
)
def test_port_that_hangs_silences_the_robots_watchdog(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, work: str, what: str
) -> None:
    monkeypatch.setattr(Port, work, desk.brake.before(getattr(Port, work)))
    desk.start_robot()
    assert desk.is_watched_well()
    desk.brake.pull()
    assert desk.is_silenced_by(f"robot/r1 {what}")
    desk.brake.release()
    assert desk.is_watched_well()


def test_correction_that_hangs_silences_the_robots_watchdog(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Corrections, "take", desk.brake.before(Corrections.take))
    desk.start_robot()
    desk.brake.pull()
    key = topics.CORRECTION.key("lab", "r1")
    desk.other.publisher(topics.CORRECTION, key).put(b"")
    assert desk.is_silenced_by("robot/r1 corrects")


def test_port_that_is_lost_is_no_hang(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bridge waits for it and says so; that it is started again would help nobody."""

    def lost(_port: Port) -> tuple[bytes, int]:
        raise PortError("Port x was lost.")

    desk.start_robot()
    monkeypatch.setattr(Port, "read", lost)
    assert desk.is_watched_well()


def test_estimator_that_hangs_silences_fusions_watchdog(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pipeline, "advance", desk.brake.before(Pipeline.advance))
    # It waits for the estimator's lock, and would hang with it.
    monkeypatch.setattr(FusionNode, "_covered", lambda _: None)
    desk.start_fusion()
    assert desk.is_watched_well()
    desk.brake.pull()
    assert desk.is_silenced_by("fusion/fusion estimates")


def test_solver_process_that_hangs_silences_fusions_watchdog(desk: Desk) -> None:
    solver = desk.start_fusion()
    assert desk.is_watched_well()
    os.kill(solver.pid, signal.SIGSTOP)
    assert desk.is_silenced_by("fusion/fusion solves")
    os.kill(solver.pid, signal.SIGCONT)
    assert desk.is_watched_well()


@pytest.mark.parametrize(
    ("owner", "work", "what"),
    [(McapWriter, "flush", "writes"), (McapSink, "write", "diagnostics")],
)
def test_file_that_hangs_silences_the_recorders_watchdog(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, owner: type, work: str, what: str
) -> None:
    monkeypatch.setattr(owner, work, desk.brake.before(getattr(owner, work)))
    desk.start_recorder()
    assert desk.is_watched_well()
    desk.brake.pull()
    assert desk.is_silenced_by(f"recorder/main {what}")
