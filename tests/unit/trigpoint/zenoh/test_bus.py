import gc
import logging
import socket
import threading
from collections.abc import Callable

import pytest
from support.builders import eventually, make_site

from trigpoint.base.errors import BusError
from trigpoint.bus.gate import Gate
from trigpoint.contract.topics import ODOMETRY, TF
from trigpoint.zenoh import open_bus


def test_unreachable_endpoint_elsewhere_is_named_when_patience_ends() -> None:
    # TEST-NET-2 (RFC 5737) is never reachable, and a client's connect fails at once or in time.
    site = make_site(bus='connect = ["tcp/198.51.100.1:9"]')
    with pytest.raises(BusError, match=r"cannot reach tcp/198\.51\.100\.1:9 \(bus\.connect\)"):
        open_bus(site, patience_s=0.0)


def test_peer_waits_for_a_meeting_point_that_comes_later(free_port: Callable[[], int]) -> None:
    port = free_port()
    with open_bus(make_site(bus=f'connect = ["tcp/127.0.0.1:{port}"]')) as early:
        assert early.peers == ()
        assert early.unreached == (f"tcp/127.0.0.1:{port}",)
        with open_bus(make_site(bus=f'listen = ["tcp/127.0.0.1:{port}"]')):
            assert eventually(lambda: early.peers != ())
            assert early.unreached == ()


def test_address_of_another_machine_cannot_be_listened_on() -> None:
    site = make_site(bus='listen = ["tcp/198.51.100.1:7447"]\ninsecure = true')
    with pytest.raises(BusError, match="the bus cannot be opened") as caught:
        open_bus(site)
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


def test_address_of_another_machine_gives_no_free_port() -> None:
    with pytest.raises(BusError, match=r"nothing can listen on tcp/198\.51\.100\.1:0"):
        open_bus(make_site(bus='listen = ["tcp/198.51.100.1:0"]\ninsecure = true'))


def test_failed_declaration_leaves_nothing_behind() -> None:
    with open_bus(make_site(bus='listen = ["tcp/127.0.0.1:0"]')) as bus:
        with pytest.raises(BusError, match="cannot be declared"):
            bus.subscribe(TF, "no//key")
        with pytest.raises(BusError, match="cannot be declared"):
            bus.publisher(ODOMETRY, "no//key")
        with pytest.raises(BusError, match="cannot be declared"):
            bus.serve("no//key", lambda payload: payload)
        with pytest.raises(BusError, match="cannot be asked"):
            bus.query("no//key")
        with pytest.raises(BusError):
            bus.alive("no//key")


def test_closed_bus_refuses_and_may_be_closed_again() -> None:
    bus = open_bus(make_site(bus='listen = ["tcp/127.0.0.1:0"]'))
    publisher = bus.publisher(TF, TF.key("lab"))
    bus.close()
    bus.close()
    with pytest.raises(BusError):
        publisher.put(b"")
    with pytest.raises(BusError):
        bus.subscribe(TF, TF.key("lab"))


def test_bus_threads_of_ours_are_only_those_that_answer() -> None:
    before = threading.active_count()
    with open_bus(make_site(bus='listen = ["tcp/127.0.0.1:0"]')) as bus:
        bus.subscribe(ODOMETRY, ODOMETRY.expression("lab"))
        assert threading.active_count() == before
        bus.serve("lab/clock", lambda payload: payload)
        assert threading.active_count() == before + 1
    gc.collect()
    assert threading.active_count() == before


def test_gate_stands_by_while_the_port_is_taken(
    free_port: Callable[[], int], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "trigpoint")
    port = free_port()
    with socket.create_server(("127.0.0.1", port)):
        site = make_site(bus=f'listen = ["tcp/127.0.0.1:{port}"]')
        with open_bus(site):
            assert eventually(lambda: "this one stands by" in caplog.text)


class _Door:
    def __init__(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False


def test_gate_takes_the_port_when_it_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trigpoint.bus.gate._RETRY_S", 0.01)
    answers: list[BusError | _Door] = [
        BusError("Address already in use"),
        BusError("something odd"),
        _Door(),
    ]
    doors: list[_Door] = []

    def open_door() -> _Door:
        answer = answers.pop(0)
        if isinstance(answer, BusError):
            raise answer
        doors.append(answer)
        return answer

    gate = Gate(("tcp/0.0.0.0:7447",), open_door)
    assert not gate.is_open
    assert eventually(lambda: gate.is_open)
    gate.close()
    assert [door.is_open for door in doors] == [False]
