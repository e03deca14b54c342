import gc
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest
from support.builders import eventually, make_site

from trigpoint.base.errors import BusError
from trigpoint.bus.bus import Subscription
from trigpoint.bus.gate import Gate
from trigpoint.bus.settings import Settings
from trigpoint.contract.topics import ODOMETRY, TF
from trigpoint.zenoh import ZenohBus, open_bus, open_session


def test_unreachable_endpoint_elsewhere_is_named_when_patience_ends() -> None:
    # TEST-NET-2 (RFC 5737) is never reachable, and a client's connect fails at once or in time.
    site = make_site(bus='connect = ["tcp/198.51.100.1:9"]')
    with pytest.raises(BusError, match=r"cannot reach tcp/198\.51\.100\.1:9 \(bus\.connect\)"):
        open_bus(site, patience_s=0.0)


def test_handshake_of_nearly_two_seconds_is_not_given_up(
    free_port: Callable[[], int],
) -> None:
    port = free_port()
    with (
        open_session(Settings("router", (f"tcp/127.0.0.1:{port}",))) as router,
        delayed(port, 0.45) as slow,
        open_session(Settings("client", connect=(f"tcp/127.0.0.1:{slow}",))) as client,
    ):
        assert client.info.routers_zid() == [router.zid()]


@pytest.mark.parametrize("goes_on", [True, False])
def test_what_was_sent_while_the_router_was_away_comes_once_and_in_order(
    free_port: Callable[[], int], *, goes_on: bool
) -> None:
    """Whether its sender goes on or has fallen silent."""
    endpoint = (f"tcp/127.0.0.1:{free_port()}",)
    client, key = Settings("client", connect=endpoint), "lab/robot/r1/odom"
    router = open_session(Settings("router", endpoint))
    with ZenohBus(open_session(client)) as sender, ZenohBus(open_session(client)) as hearer:
        came, publisher = hearer.subscribe(ODOMETRY, key), sender.publisher(ODOMETRY, key)
        assert eventually(lambda: publisher.has_listener)
        publisher.put(b"0")
        assert taken(came) == b"0"
        router.close()
        assert eventually(lambda: not (sender.peers or hearer.peers))
        for number in range(1, 5):
            publisher.put(b"%d" % number)
        with open_session(Settings("router", endpoint)):
            if goes_on:
                assert eventually(lambda: bool(sender.peers))
                publisher.put(b"5")
            expected = [b"%d" % number for number in range(1, 6 if goes_on else 5)]
            assert [taken(came) for _ in expected] == expected
    assert came.take(0.0) is None
    assert came.dropped == 0


def taken(subscription: Subscription) -> bytes:
    sample = subscription.take(30.0)
    assert sample is not None
    return sample.payload


@contextmanager
def delayed(port: int, delay_s: float) -> Iterator[int]:
    """A port of this machine that leads to another, each way so much later, for one connection."""

    def bring(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                time.sleep(delay_s)
                sink.sendall(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def accept() -> None:
        near, _ = server.accept()
        with near, socket.create_connection(("127.0.0.1", port)) as far:
            back = threading.Thread(target=bring, args=(far, near))
            back.start()
            bring(near, far)
            back.join()

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=accept)
        thread.start()
        yield server.getsockname()[1]
        thread.join()


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
