"""A site with [bus.tls]: its own nodes work as ever, and nobody else gets in."""

import json
import logging
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace
from support.builders import eventually
from support.site.secured import SecuredSite, needs_zenohd

from trigpoint.base.errors import BusError, ConfigError
from trigpoint.bus.bus import Bus
from trigpoint.bus.settings import Multicast, Settings, TlsFiles
from trigpoint.bus.urgent import AGAIN_S
from trigpoint.contract.access import Identity, Kind
from trigpoint.contract.topics import (
    CAMERA_INFO,
    CORRECTION,
    DIAGNOSTICS,
    IMAGE,
    ODOMETRY,
    SIGHTINGS,
)
from trigpoint.tools.secure import authority as authority_module
from trigpoint.zenoh import Datagrams, ZenohBus, open_bus, open_router, open_session
from trigpoint.zenoh.patience import open_patiently

OUTSIDE = "from outside"
FUSION, CAMERA, ROBOT = (Kind.FUSION, "fusion"), (Kind.CAMERA, "c1"), (Kind.ROBOT, "r1")


@pytest.fixture
def secured(tmp_path: Path, free_port: Callable[[], int]) -> SecuredSite:
    return SecuredSite(tmp_path, free_port())


@pytest.fixture(params=["gate", "router"])
def buses(
    secured: SecuredSite, request: pytest.FixtureRequest, stack: ExitStack
) -> tuple[Bus, Bus, Bus]:
    """Fusion, a camera and a robot on three machines, joined by a gate or a router."""
    if request.param == "gate":
        fusion = stack.enter_context(open_bus(secured.listening, FUSION))
    else:
        stack.enter_context(open_router(secured.listening))
        fusion = stack.enter_context(ZenohBus(secured.session(*FUSION)))
    camera = stack.enter_context(ZenohBus(secured.session(*CAMERA)))
    robot = stack.enter_context(ZenohBus(secured.session(*ROBOT)))
    return fusion, camera, robot


def test_what_was_said_before_somebody_came_is_caught_up(buses: tuple[Bus, Bus, Bus]) -> None:
    fusion, camera, robot = buses
    senders = [(SIGHTINGS, camera, "c1"), (CAMERA_INFO, camera, "c1"), (ODOMETRY, robot, "r1")]
    for topic, bus, name in senders:
        publisher = bus.publisher(topic, topic.key("lab", name))
        for number in range(topic.cache + 2):
            publisher.put(str(number).encode())
        assert bus.flush(10.0)
        subscription = fusion.subscribe(topic, topic.expression("lab"))
        expected = [str(n).encode() for n in range(topic.cache + 2)]
        taken: list[bytes] = []
        while taken[-1:] != expected[-1:]:
            sample = subscription.take(60.0)
            assert sample is not None
            taken.append(sample.payload)
        # What is kept for who comes late; the two before it too where they were still on their way.
        assert topic.cache <= len(taken)
        assert taken == expected[-len(taken) :]
        publisher.put(b"live")
        sample = subscription.take(60.0)
        assert sample is not None
        assert sample.payload == b"live"
        assert subscription.dropped == 0


def test_corrections_arrive_and_pictures_leave_only_when_somebody_looks(
    buses: tuple[Bus, Bus, Bus],
) -> None:
    fusion, camera, robot = buses
    key = CORRECTION.key("lab", "r1")
    corrections = robot.subscribe(CORRECTION, key)
    publisher = fusion.publisher(CORRECTION, key)
    assert eventually(lambda: publisher.has_listener)
    publisher.put(b"here", attachment=b"mark")
    sample = corrections.take(60.0)
    assert sample is not None
    assert (sample.payload, sample.attachment) == (b"here", b"mark")
    pictures = camera.publisher(IMAGE, IMAGE.key("lab", "c1"))
    assert not pictures.has_listener


def test_everyone_sees_who_is_alive(buses: tuple[Bus, Bus, Bus]) -> None:
    fusion, camera, robot = buses
    fusion.declare_alive("lab/alive/fusion/fusion")
    camera.declare_alive("lab/alive/edge/c1")
    camera.declare_alive("lab/alive/edge/c2")  # not its own: only its own session takes it so
    robot.declare_alive("lab/alive/robot/r1")
    everyone = ["lab/alive/edge/c1", "lab/alive/fusion/fusion", "lab/alive/robot/r1"]
    for bus in (fusion, robot):
        assert eventually(lambda bus=bus: bus.alive("lab/alive/*/*") == everyone)
    with_its_lie = sorted([*everyone, "lab/alive/edge/c2"])
    assert eventually(lambda: camera.alive("lab/alive/*/*") == with_its_lie)
    for bus in (fusion, robot):
        assert bus.alive("lab/alive/*/*") == everyone


def test_viewer_looks_at_pictures(buses: tuple[Bus, Bus, Bus], secured: SecuredSite) -> None:
    _, camera, _ = buses
    pictures = camera.publisher(IMAGE, IMAGE.key("lab", "c1"))
    with ZenohBus(secured.session(Kind.VIEWER, "bob")) as viewer:
        looking = viewer.subscribe(IMAGE, IMAGE.expression("lab"))
        assert eventually(lambda: pictures.has_listener)
        pictures.put(b"picture")
        assert looking.take(60.0) is not None
        looking.close()
    assert eventually(lambda: not pictures.has_listener)


@pytest.mark.parametrize("streams", ["tls", "quic"])
def test_correction_by_stream_and_datagrams_comes_once(
    tmp_path: Path, free_port: Callable[[], int], stack: ExitStack, streams: str
) -> None:
    """Three copies a way of each: two datagrams, and a stream's."""
    port = free_port()
    endpoints = [f"{protocol}/127.0.0.1:{port}" for protocol in ("tls", "quic")]
    site = SecuredSite(tmp_path, port, bus=f"listen = {json.dumps(endpoints)}", protocol=streams)
    stack.enter_context(open_router(site.listening))
    fusion, robot = (_with_datagrams(site, endpoints[1], *who, stack) for who in (FUSION, ROBOT))
    key = CORRECTION.key("lab", "r1")
    corrections, publisher = robot.subscribe(CORRECTION, key), fusion.publisher(CORRECTION, key)
    assert eventually(lambda: publisher.has_listener)
    for number in range(20):
        payload = str(number).encode()
        publisher.put(payload, attachment=b"mark")
        sample = corrections.take(60.0)  # one after the other, so that none is overtaken
        assert sample is not None
        assert (sample.payload, sample.sender) == (payload, fusion.identity)
    time.sleep(10 * AGAIN_S)
    assert corrections.take(0.0) is None


def test_datagrams_come_back_where_their_session_does_not(
    tmp_path: Path, free_port: Callable[[], int], stack: ExitStack
) -> None:
    """It lives and reaches nobody, as where its link was lost and Zenoh did not see it."""
    port = free_port()
    endpoints = [f"{protocol}/127.0.0.1:{port}" for protocol in ("tls", "quic")]
    site = SecuredSite(tmp_path, port, bus=f"listen = {json.dumps(endpoints)}")
    stack.enter_context(open_router(site.listening))
    robot = _with_datagrams(site, endpoints[1], *ROBOT, stack)
    beside = replace(site.settings(*FUSION), connect=(endpoints[1],))
    main, lost = site.session(*FUSION), open_session(Settings("peer"))
    datagrams = Datagrams(
        lost,
        is_beside=True,
        connect=beside.connect,
        reopen=lambda: open_session(beside),
        main=main,
        lost_s=0.5,
    )
    fusion = stack.enter_context(ZenohBus(main, datagrams=datagrams))
    key = CORRECTION.key("lab", "r1")
    came, publisher = robot.subscribe(CORRECTION, key), datagrams.publisher(CORRECTION, key)

    def comes_by_datagram() -> bool:
        publisher.put(b"here", attachment=None, timestamp=main.new_timestamp())
        return came.take(0.2) is not None

    assert eventually(comes_by_datagram, timeout_s=60.0)
    assert fusion.unreached == ()
    assert eventually(lost.is_closed)


def _with_datagrams(
    site: SecuredSite, quic: str, kind: Kind, name: str, stack: ExitStack
) -> ZenohBus:
    session = site.session(kind, name)
    is_beside = not site.endpoint.startswith("quic/")
    beside = replace(site.settings(kind, name), connect=(quic,))
    by = open_patiently(lambda: open_session(beside), beside, 60.0) if is_beside else session
    connect = beside.connect if is_beside else ()
    return stack.enter_context(
        ZenohBus(session, datagrams=Datagrams(by, is_beside=is_beside, connect=connect))
    )


class Outsider:
    """Somebody who tries to get in by one way, and to hear and say something once inside."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.heard: list[str] = []

    def try_it(self, site: set[str], seconds: float = 2.0) -> bool:
        """Whether a session came about with one of these; others of this machine may scout too."""
        try:
            session = open_session(self._settings)
        except BusError:
            return False
        with session:
            session.declare_subscriber("**", zenoh.handlers.Callback(self._hear, indirect=False))
            met = eventually(lambda: bool(site & _met_by(session)), seconds)
            session.put("lab/robot/r1/correction", OUTSIDE)
            time.sleep(0.2)
            return met

    def _hear(self, sample: zenoh.Sample) -> None:
        if sample.payload.to_string() != OUTSIDE:  # its own
            self.heard.append(str(sample.key_expr))


def _met_by(session: zenoh.Session) -> set[str]:
    return {
        str(zid).lstrip("0") for zid in (*session.info.peers_zid(), *session.info.routers_zid())
    }


def _files(secured: SecuredSite, folder: Path, stem: str) -> TlsFiles:
    trust = secured.folder / "secure" / "trust.pem"
    return TlsFiles(str(trust), str(folder / f"{stem}.pem"), str(folder / f"{stem}.key"))


def _client(secured: SecuredSite, files: TlsFiles | None) -> Settings:
    return Settings("client", connect=(secured.endpoint,), files=files)


def wrong_authority(secured: SecuredSite, folder: Path) -> Settings:
    """A certificate with fusion's name, of an authority of somebody's own."""
    other = SecuredSite(folder / "other", 1)
    return _client(secured, _files(secured, other.folder / "secure", "fusion-fusion"))


def expired(secured: SecuredSite, folder: Path) -> Settings:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(authority_module, "_SKEW", timedelta(days=400))
        patch.setattr(authority_module, "datetime", _Yesteryear)
        secured.admit(Kind.OPERATOR, "late", days=90)
    return _client(secured, _files(secured, secured.folder / "secure", "operator-late"))


class _Yesteryear(datetime):
    @classmethod
    def now(cls, _tz: object = None) -> datetime:  # type: ignore[override]
        return datetime.now(UTC) - timedelta(days=200)


def revoked(secured: SecuredSite, folder: Path) -> Settings:
    kept = folder / "kept"
    shutil.copytree(secured.folder / "secure", kept)
    secured.authority.revoke(Identity("lab", Kind.OPERATOR, "anna"))
    return _client(secured, _files(secured, kept, "operator-anna"))


def no_certificate(secured: SecuredSite, folder: Path) -> Settings:
    return _client(secured, None)


def plain_peer(secured: SecuredSite, folder: Path) -> Settings:
    if secured.endpoint.startswith("quic/"):  # a peer waits ten seconds for UDP's answer
        return Settings("client", connect=(secured.endpoint.replace("quic/", "udp/"),))
    plain = secured.endpoint.replace("tls/", "tcp/")
    return Settings("peer", ("tcp/127.0.0.1:0",), (plain,))


def scouting_neighbour(secured: SecuredSite, folder: Path) -> Settings:
    return Settings("peer", ("tcp/127.0.0.1:0",), multicast=Multicast("auto", "224.0.0.224:7446"))


WAYS = (wrong_authority, expired, revoked, no_certificate, plain_peer, scouting_neighbour)


@pytest.mark.parametrize(
    ("door", "protocol"),
    [
        *(("gate", "tls"), ("router", "tls"), ("router", "quic")),
        *(pytest.param("zenohd", p, marks=needs_zenohd) for p in ("tls", "quic")),
    ],
)
def test_strangers_get_neither_session_nor_byte(
    tmp_path: Path, free_port: Callable[[], int], stack: ExitStack, door: str, protocol: str
) -> None:
    """All at once: each tries for two seconds."""
    secured = SecuredSite(tmp_path, free_port(), protocol=protocol)
    outsiders = {way.__name__: Outsider(way(secured, tmp_path / way.__name__)) for way in WAYS}
    site = set[str]()
    if door == "gate":
        site.add(stack.enter_context(open_bus(secured.listening, FUSION)).identity)
    elif door == "router":
        site.add(stack.enter_context(open_router(secured.listening)).identity)
    else:
        stack.enter_context(secured.zenohd())
    robot = stack.enter_context(ZenohBus(secured.session(*ROBOT)))
    corrections = robot.subscribe(CORRECTION, CORRECTION.key("lab", "r1"))
    odometry = robot.publisher(ODOMETRY, ODOMETRY.key("lab", "r1"))
    odometry.put(b"secret")
    site |= {robot.identity, *robot.peers}
    with ThreadPoolExecutor(len(outsiders)) as pool:
        met = pool.map(lambda outsider: outsider.try_it(site), outsiders.values())
    assert dict(zip(outsiders, met, strict=True)) == dict.fromkeys(outsiders, False)
    assert {name: outsider.heard for name, outsider in outsiders.items()} == {
        name: [] for name in outsiders
    }
    assert corrections.take(0.1) is None


def test_client_does_not_take_a_camera_for_the_router(secured: SecuredSite) -> None:
    """Who steals a camera's key cannot put up a router with it."""
    files = _files(secured, secured.folder / "secure", "camera-c1")
    with (
        open_session(Settings("router", (secured.endpoint,), files=files)),
        pytest.raises(BusError, match="cannot reach"),
    ):
        open_session(secured.settings(*ROBOT))


@pytest.mark.parametrize("door", ["gate"])
def test_revoked_node_is_cut_off_and_the_others_come_back(
    secured: SecuredSite, stack: ExitStack, door: str
) -> None:
    fusion = stack.enter_context(open_bus(secured.listening, FUSION))
    camera = stack.enter_context(ZenohBus(secured.session(*CAMERA)))
    operator = stack.enter_context(ZenohBus(secured.session(Kind.OPERATOR, "anna")))
    heard = fusion.subscribe(DIAGNOSTICS, DIAGNOSTICS.key("lab"))
    said = camera.publisher(DIAGNOSTICS, DIAGNOSTICS.key("lab"))
    assert eventually(lambda: operator.peers != () and said.has_listener)
    secured.authority.revoke(Identity("lab", Kind.OPERATOR, "anna"))
    assert eventually(lambda: operator.peers == ())
    assert eventually(lambda: camera.peers != () and said.has_listener)
    came = []

    def is_heard() -> bool:  # what is sent while a link settles may be lost
        said.put(b"here again")
        came.append(heard.take(0.5))
        return came[-1] is not None

    assert eventually(is_heard)
    sample = came[-1]
    assert sample is not None
    time.sleep(1.0)  # the operator's session tries again all the while
    assert operator.peers == ()


def test_key_that_others_can_read_is_refused(secured: SecuredSite) -> None:
    key = secured.folder / "secure" / "camera-c1.key"
    key.chmod(0o640)
    with pytest.raises(ConfigError, match=r"camera-c1\.key can be read by others \(mode 0640\)"):
        open_bus(secured.connecting, CAMERA)
    (secured.folder / "secure" / "trust.pem").chmod(0o666)
    with pytest.raises(ConfigError, match=r"trust\.pem can be written by others"):
        open_bus(secured.connecting, ROBOT)


def test_machine_that_listens_needs_its_routers_key(secured: SecuredSite) -> None:
    (secured.folder / "secure" / "router-hall.key").unlink()
    with pytest.raises(ConfigError, match="no router's key"):
        open_bus(secured.listening, FUSION)


def test_no_secret_is_told(
    secured: SecuredSite, stack: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    stack.enter_context(open_router(secured.listening))
    camera = stack.enter_context(open_bus(secured.connecting, CAMERA))
    assert eventually(lambda: camera.peers != ())
    told = caplog.text + repr(secured.settings(*CAMERA)) + repr(secured.settings(*CAMERA).values())
    for key in (secured.folder / "secure").glob("*.key"):
        lines = key.read_text().splitlines()[1:-1]
        assert not any(line in told for line in lines)
