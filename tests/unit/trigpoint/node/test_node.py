import logging
import signal
import threading
import time
from collections.abc import Iterator

import pytest
from support.builders import eventually

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import OperationError, PortError
from trigpoint.contract.cdr import decode, encode
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.contract.topics import DIAGNOSTICS, alive_key
from trigpoint.node import node as node_module
from trigpoint.node.node import Node, stop_on_signals, stopped_by_signals
from trigpoint.testing.memory_bus import MemoryBroker, MemoryBus

KEY = DIAGNOSTICS.key("lab")
PERIOD_S = 0.02


def make_node(bus: MemoryBus, name: str = "c1", stopping: threading.Event | None = None) -> Node:
    return Node(bus, site="lab", kind="edge", name=name, period_s=PERIOD_S, stopping=stopping)


def next_status(bus: MemoryBus) -> DiagnosticStatus:
    """The status of edge/c1 that is published after now."""
    subscription = bus.subscribe(DIAGNOSTICS, KEY)
    try:
        while True:
            sample = subscription.take(60.0)
            assert sample is not None
            message = decode(DIAGNOSTICS.type_name, sample.payload)
            assert isinstance(message, Diagnostics)
            if message.statuses[0].name == "edge/c1":
                return message.statuses[0]
    finally:
        subscription.close()


def foreign_diagnostics(name: str, **values: str) -> bytes:
    own = {"node": "f" * 32, "contract": "1", "started": "1000", "process": "7"}
    status = DiagnosticStatus(0, name, "running", "elsewhere", own | values)
    return encode(Diagnostics(1, (status,)))


@pytest.fixture
def bus() -> Iterator[MemoryBus]:
    with MemoryBroker().session() as session:
        yield session


def test_node_is_alive_from_entry_to_exit(bus: MemoryBus) -> None:
    with make_node(bus):
        assert bus.alive("lab/alive/**") == [alive_key("lab", "edge", "c1")]
    assert bus.alive("lab/alive/**") == []


def test_diagnostics_say_who_speaks_and_how_it_goes(bus: MemoryBus) -> None:
    with make_node(bus) as node:
        node.health.count("sightings", 3)
        assert eventually(lambda: next_status(bus).values.get("sightings.total") == "3")
        status = next_status(bus)
    assert (status.level, status.name, status.message) == (0, "edge/c1", "running")
    assert status.values["session"] == bus.identity
    assert status.values["contract"] == "1"


def test_second_node_of_the_same_identity_refuses_to_start(
    bus: MemoryBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.node.node._TAKEOVER_S", 0.1)
    with make_node(bus), pytest.raises(OperationError, match="edge/c1 already runs on site lab"):
        make_node(bus).__enter__()


def test_killed_predecessors_token_is_waited_for(bus: MemoryBus) -> None:
    token = bus.declare_alive(alive_key("lab", "edge", "c1"))
    gone = threading.Timer(0.3, token.close)
    gone.start()
    with make_node(bus):
        assert bus.alive("lab/alive/**") != []
    gone.join()


def test_newcomer_that_hears_its_elder_stops_with_one_line(bus: MemoryBus) -> None:
    with make_node(bus) as node:
        bus.publisher(DIAGNOSTICS, KEY).put(foreign_diagnostics("edge/c1"))
        with pytest.raises(OperationError, match="already runs"):
            node.wait()


def test_elder_names_its_double_and_goes_on(
    bus: MemoryBus, caplog: pytest.LogCaptureFixture
) -> None:
    with make_node(bus) as node:
        bus.publisher(DIAGNOSTICS, KEY).put(foreign_diagnostics("edge/c1", started=str(2**62)))
        assert eventually(lambda: "a second edge/c1" in next_status(bus).message)
        assert not node.stopping.is_set()
    assert "a second edge/c1 (host elsewhere, process 7) is on the site" in caplog.text


def test_other_contract_is_named(bus: MemoryBus, caplog: pytest.LogCaptureFixture) -> None:
    with make_node(bus):
        bus.publisher(DIAGNOSTICS, KEY).put(foreign_diagnostics("robot/r1", contract="2"))
        assert eventually(lambda: "speaks contract 2" in next_status(bus).message)
    assert caplog.text.count("robot/r1 (host elsewhere, process 7) speaks contract 2") == 1


def test_lost_connection_is_told_once_and_its_return_too(
    bus: MemoryBus, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["tcp/127.0.0.1:9"]
    monkeypatch.setattr(MemoryBus, "unreached", property(lambda _: tuple(names)))
    with make_node(bus):
        message = "nobody answers at tcp/127.0.0.1:9 (bus.connect); trying again"
        assert eventually(lambda: next_status(bus).message == message)
        next_status(bus)
        names.clear()
        assert eventually(lambda: next_status(bus).message == "running")
    assert caplog.text.count(message) == 1
    assert caplog.text.count("connected again") == 1


def test_nothing_that_is_wrong_hides_another(
    bus: MemoryBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = "the certificate ends in 3 days"
    monkeypatch.setattr(MemoryBus, "warning", property(lambda _: ends))
    monkeypatch.setattr(MemoryBus, "unreached", property(lambda _: ("tcp/127.0.0.1:9",)))
    with make_node(bus) as node:
        bus.publisher(DIAGNOSTICS, KEY).put(foreign_diagnostics("robot/r1", contract="2"))
        assert eventually(lambda: "speaks contract" in next_status(bus).message)
        outside = next_status(bus)
        node.health.hold("source", "the camera is lost")
        held = next_status(bus)
    assert (outside.level, held.level) == (2, 2)
    for word in ("speaks contract 2", "nobody answers", ends):
        assert word in outside.message, word
    for word in ("speaks contract 2", "nobody answers", "the camera is lost", ends):
        assert word in held.message, word


def test_a_complaint_stays_the_same_while_losses_come_and_go(
    bus: MemoryBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it would be another alarm each time."""
    ends = "the certificate ends in 3 days"
    with make_node(bus) as node:
        node.health.lose("pictures")
        assert node.diagnostics().statuses[0].message == "lost so far: 1 picture"
        monkeypatch.setattr(MemoryBus, "warning", property(lambda _: ends))
        (status,) = node.diagnostics().statuses
    assert (status.level, status.message, status.values["pictures.lost"]) == (1, ends, "1")


def test_garbage_on_the_diagnostics_is_rejected_and_its_sender_named(bus: MemoryBus) -> None:
    with make_node(bus) as node:
        bus.publisher(DIAGNOSTICS, KEY).put(b"garbage")
        assert eventually(lambda: node.health.total("rejected") == 1)
        status = next_status(bus)
    assert (status.level, status.values["rejected.total"]) == (2, "1")
    assert f"from session {bus.identity}" in status.values["last_error"]


def test_last_error_is_logged_once(bus: MemoryBus, caplog: pytest.LogCaptureFixture) -> None:
    with make_node(bus) as node:
        node.health.fail("the lens is covered")
        next_status(bus)
        next_status(bus)
    assert caplog.text.count("the lens is covered") == 1


def test_error_in_a_thread_stops_the_node_and_is_raised_by_wait(bus: MemoryBus) -> None:
    def fail() -> None:
        raise PortError("the port is gone")

    with make_node(bus) as node:
        node.thread("fail", fail)
        with pytest.raises(PortError, match="the port is gone"):
            node.wait()


def test_error_in_a_thread_is_raised_at_the_end_where_nobody_waits(bus: MemoryBus) -> None:
    def fail() -> None:
        raise PortError("the port is gone")

    node = make_node(bus).__enter__()
    node.thread("fail", fail)
    assert node.stopping.wait(60.0)
    with pytest.raises(PortError):
        node.__exit__(None, None, None)


def test_nodes_that_share_their_stopping_end_together(bus: MemoryBus) -> None:
    stopping = threading.Event()
    with make_node(bus, "c1", stopping) as one, make_node(bus, "c2", stopping) as two:
        two.stop()
        one.wait()
        assert one.stopping.is_set()


def test_thread_that_does_not_stop_is_named(
    bus: MemoryBus, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.node.node.STOP_S", 0.1)
    release = threading.Event()
    with make_node(bus) as node:
        node.thread("stubborn", lambda: release.wait(60.0))
    release.set()
    assert "thread «edge/c1 stubborn» did not stop" in caplog.text


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_stops_the_node(bus: MemoryBus, number: signal.Signals) -> None:
    with make_node(bus) as node:
        stop_on_signals([node])
        signal.raise_signal(number)
        node.wait()
        assert node.stopping.is_set()


def test_further_signals_change_nothing(bus: MemoryBus) -> None:
    with make_node(bus) as node:
        stop_on_signals([node])
        signal.raise_signal(signal.SIGINT)
        node.wait()
        left_s = ENDING.left_s()
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert node.stopping.is_set()
        assert ENDING.left_s() <= left_s  # they win no more time
        assert bus.alive("lab/alive/**") == [alive_key("lab", "edge", "c1")]
    assert bus.alive("lab/alive/**") == []


def test_signal_that_came_before_stops_the_node(bus: MemoryBus) -> None:
    ENDING.ask()
    with stopped_by_signals(make_node(bus)) as node:
        node.wait()
        assert node.stopping.is_set()


def test_stop_is_logged(bus: MemoryBus, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "trigpoint")
    with make_node(bus):
        time.sleep(PERIOD_S)
    assert "edge/c1 stopped" in caplog.text


def test_node_tells_which_servers_it_has_heard(bus: MemoryBus) -> None:
    with make_node(bus) as node:
        assert node.silent_s("fusion") is None
        bus.publisher(DIAGNOSTICS, KEY).put(foreign_diagnostics("fusion/fusion"))
        assert eventually(lambda: next_status(bus).values["met"] == "fusion")
        heard_s = node.silent_s("fusion")
        assert heard_s is not None
        assert heard_s < 10.0


def test_what_all_nodes_of_a_process_hear_is_decoded_once() -> None:
    payload = foreign_diagnostics("fusion/fusion")
    first, second = (node_module._heard(bytes(bytearray(payload))) for _ in range(2))
    assert first is second
