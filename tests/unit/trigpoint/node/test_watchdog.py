"""The service manager is told that all is well only while every thread says so."""

import socket
from pathlib import Path

import pytest
from support.builders import eventually, told

from trigpoint.base.clock import ManualClock
from trigpoint.node.node import Node
from trigpoint.node.watchdog import SOCKET, Watchdog
from trigpoint.testing.memory_bus import MemoryBroker


def watchdog_of(manager: socket.socket, clock: ManualClock) -> Watchdog:
    return Watchdog({SOCKET: manager.getsockname()}, clock)


def test_ready_is_said_once_and_then_that_all_is_well(manager: socket.socket) -> None:
    watchdog = watchdog_of(manager, ManualClock())
    watchdog.tick()
    watchdog.tick()
    assert told(manager) == ["READY=1\nWATCHDOG=1", "WATCHDOG=1"]


def test_overdue_thread_silences_it_until_it_is_back(
    manager: socket.socket, caplog: pytest.LogCaptureFixture
) -> None:
    clock = ManualClock()
    watchdog = watchdog_of(manager, clock)
    pulse, other = (watchdog.pulse(name, within_s=5.0) for name in ("c1", "c2"))
    clock.advance(6.0)
    other.beat(100.0)
    watchdog.tick()
    assert (told(manager), watchdog.hung) == ([], ("c1",))
    assert "no sign of life of: c1" in caplog.text
    pulse.beat(5.0)
    watchdog.tick()
    assert len(told(manager)) == 1


def test_beat_without_a_time_is_good_for_the_usual_one() -> None:
    clock = ManualClock()
    watchdog = Watchdog({}, clock)
    pulse = watchdog.pulse("c1", within_s=5.0)
    pulse.beat(100.0)
    clock.advance(50.0)
    pulse.beat()
    clock.advance(4.0)
    assert watchdog.hung == ()
    clock.advance(2.0)
    assert watchdog.hung == ("c1",)


def test_thread_that_has_ended_is_not_waited_for(manager: socket.socket) -> None:
    clock = ManualClock()
    watchdog = watchdog_of(manager, clock)
    watchdog.forget(watchdog.pulse("c1", within_s=1.0))
    clock.advance(2.0)
    watchdog.tick()
    assert told(manager)


def test_without_a_service_manager_nothing_is_sent_but_who_hangs_is_known() -> None:
    clock = ManualClock()
    watchdog = Watchdog({}, clock)
    watchdog.pulse("c1", within_s=1.0)
    clock.advance(2.0)
    watchdog.tick()
    assert watchdog.hung == ("c1",)


def test_manager_that_is_gone_is_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    Watchdog({SOCKET: str(tmp_path / "none")}).tick()
    assert "cannot be told" in caplog.text


def test_node_tells_the_manager_while_it_runs_and_says_who_hangs(manager: socket.socket) -> None:
    watchdog = Watchdog({SOCKET: manager.getsockname()})
    with (
        MemoryBroker().session() as bus,
        Node(bus, site="lab", kind="edge", name="c1", watchdog=watchdog, period_s=0.01) as node,
    ):
        said: list[str] = []
        assert eventually(lambda: bool(said.extend(told(manager)) or len(said) > 2))
        assert said[0] == "READY=1\nWATCHDOG=1"
        watchdog.pulse("edge/c1 sees", within_s=-1.0)
        (status,) = node.diagnostics().statuses
        assert (status.level, status.message) == (2, "no sign of life of: edge/c1 sees")
    assert watchdog.hung == ("edge/c1 sees",)
