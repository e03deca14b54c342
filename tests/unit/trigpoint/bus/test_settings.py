import pytest
from support.builders import make_odometry

from trigpoint.bus.settings import (
    LOOPBACK,
    QUEUE_BATCHES,
    Door,
    TlsFiles,
    datagram_settings,
    has_datagrams,
    session_settings,
)
from trigpoint.contract.cdr import encode
from trigpoint.contract.topics import ODOMETRY
from trigpoint.site.config import BusConfig, TlsConfig, endpoint_port


def test_without_a_bus_table_nothing_leaves_this_machine() -> None:
    settings = session_settings("lab", BusConfig())
    assert (settings.mode, settings.listen, settings.connect) == ("peer", (LOOPBACK,), ())
    assert settings.multicast is not None
    assert settings.multicast.interface == "127.0.0.1"
    assert settings.gate == ()


def test_sites_have_meeting_places_of_their_own() -> None:
    groups = {session_settings(name, BusConfig()).multicast for name in ("lab", "hall", "attic")}
    assert len(groups) == 3


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_connecting_within_this_machine_is_done_as_a_peer(host: str) -> None:
    settings = session_settings("lab", BusConfig(connect=(f"tcp/{host}:7447",)))
    assert (settings.mode, settings.listen, settings.multicast) == ("peer", (LOOPBACK,), None)


def test_connecting_to_another_machine_opens_nothing() -> None:
    settings = session_settings("lab", BusConfig(connect=("tls/10.0.0.1:7447",), tls=TlsConfig()))
    assert (settings.mode, settings.listen, settings.multicast) == ("client", (), None)
    assert settings.connect == ("tls/10.0.0.1:7447",)


def test_a_written_port_is_left_to_the_gate() -> None:
    endpoint = "tcp/0.0.0.0:7447"
    settings = session_settings("lab", BusConfig(listen=(endpoint,), insecure=True))
    assert (settings.listen, settings.gate) == ((LOOPBACK,), (endpoint,))
    assert settings.locators == (endpoint,)
    gate = settings.gate_settings()
    assert gate.listen == (LOOPBACK, endpoint)
    assert gate.multicast == settings.multicast is not None


def test_port_0_becomes_a_port_that_others_can_be_told() -> None:
    settings = session_settings("lab", BusConfig(listen=("tcp/127.0.0.1:0",)))
    [locator] = settings.locators
    assert endpoint_port(locator) > 0
    assert settings.listen == (locator,)
    assert settings.multicast is None


def test_scouting_looks_for_peers_on_the_link() -> None:
    settings = session_settings(
        "lab", BusConfig(scouting=True, listen=("tcp/0.0.0.0:0",), insecure=True)
    )
    assert (settings.mode, settings.listen) == ("peer", ("tcp/0.0.0.0:0",))
    assert settings.multicast is not None
    assert settings.multicast.interface == "auto"
    assert settings.locators == ()


def test_what_a_link_may_hold_is_as_much_as_a_publisher_keeps() -> None:
    """After a break all of it is asked for at once; held up for long, the link would be cut off."""
    batch = 65_535
    odometry = len(encode(make_odometry(10**18)))
    assert QUEUE_BATCHES * batch >= ODOMETRY.cache * odometry


def test_datagrams_leave_by_a_client_of_their_own_where_there_is_a_stream_too() -> None:
    tls, quic = "tls/10.0.0.1:7447", "quic/10.0.0.1:7447"
    bus = BusConfig(connect=(quic, tls), tls=TlsConfig())
    files = TlsFiles("trust.pem", "own.pem", "own.key")
    settings = session_settings("lab", bus, files)
    beside = datagram_settings(bus, settings)
    assert has_datagrams(bus)
    assert settings.connect == (tls,)
    assert beside is not None
    assert (beside.mode, beside.connect, beside.files) == ("client", (quic,), files)
    assert beside.values()["connect/endpoints"] == [f"{quic}?multistream=1;mixed_rel=1"]


QUIC = ("quic/10.0.0.1:7447",)


@pytest.mark.parametrize(
    "bus", [BusConfig(connect=QUIC, tls=TlsConfig()), BusConfig(listen=QUIC, tls=TlsConfig())]
)
def test_quic_alone_carries_both(bus: BusConfig) -> None:
    settings = session_settings("lab", bus)
    assert has_datagrams(bus)
    assert datagram_settings(bus, settings) is None
    assert (settings.connect or settings.gate) == QUIC


def test_without_quic_there_are_no_datagrams() -> None:
    assert not has_datagrams(BusConfig(connect=("tls/10.0.0.1:7447",), tls=TlsConfig()))


def test_certificates_are_shown_where_a_link_leaves_and_where_one_ends() -> None:
    files = TlsFiles("trust.pem", "own.pem", "own.key")
    bus = BusConfig(connect=("tls/10.0.0.1:7447",), tls=TlsConfig())
    values = session_settings("lab", bus, files).values()
    assert values["transport/link/tls"] == files.values()
    assert files.values()["enable_mtls"] is True
    assert files.values()["verify_name_on_connect"] is True
    listening = BusConfig(listen=("tls/0.0.0.0:7447",), tls=TlsConfig())
    gate = session_settings("lab", listening).gate_settings(Door(files, {"enabled": True}))
    assert gate.values()["access_control"] == {"enabled": True}
    assert "transport/link/tls" not in session_settings("lab", listening).values()
