"""Every kind of node, every key, and what may be done there, over mutual TLS: as the contract says.

The expected cells are written out here from the contract's table of keys; the rules under test are
made from another one (`contract.access`). Where a stock `zenohd` is installed it is tried too.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest
import zenoh
from support.builders import eventually
from support.site.secured import NODES, SecuredSite, needs_zenohd

from trigpoint.bus.settings import session_settings
from trigpoint.contract.access import Kind
from trigpoint.zenoh import open_bus, open_router, open_session

SITE = "lab"
CAMERA_KEYS = ("image/compressed", "camera_info", "sightings", "pose", "snapshot", "calibrate")
ROBOT_KEYS = ("odom", "pose", "correction", "suggestion", "particles", "corrected", "tf")
ROBOTS_OWN = ("odom", "corrected", "tf")
KEYS = (
    *(f"camera/{camera}/{key}" for camera in ("c1", "c2") for key in CAMERA_KEYS),
    *(f"robot/{robot}/{key}" for robot in ("r1", "r2") for key in ROBOT_KEYS),
    *("coverage", "coverage/c1", "coverage/c2", "tf", "diagnostics", "clock"),
    *("fusion/network", "fusion/map", "fusion/reset", "fusion/learn", "recorder/stop"),
    "alive/edge/c1",
    "alive/robot/r1",
    "sent/1",
    "anything/else",
)
DATA = tuple(
    key
    for key in KEYS
    if not key.startswith(("fusion/", "recorder/", "alive/", "sent/", "anything/"))
    and not key.endswith(("snapshot", "calibrate", "clock"))
)
OWN_CAMERA = ("camera/c1/image/compressed", "camera/c1/camera_info", "camera/c1/sightings")
SEEN = tuple(f"camera/{c}/{key}" for c in ("c1", "c2") for key in ("camera_info", "sightings"))
ESTIMATES = (
    *(f"camera/{camera}/pose" for camera in ("c1", "c2")),
    *(
        f"robot/{robot}/{key}"
        for robot in ("r1", "r2")
        for key in ROBOT_KEYS
        if key not in ROBOTS_OWN
    ),
    *("coverage", "coverage/c1", "coverage/c2", "tf"),
)
CAMERA_COMMANDS = tuple(
    f"camera/{c}/{key}" for c in ("c1", "c2") for key in ("snapshot", "calibrate")
)
FUSION_COMMANDS = ("fusion/network", "fusion/map", "fusion/reset", "fusion/learn")


@dataclass(frozen=True)
class May:
    """What one node may do: the keys of each verb."""

    put: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()
    get: tuple[str, ...] = ()
    reply: tuple[str, ...] = ()


EXPECTED = {
    Kind.CAMERA: May(
        put=(*OWN_CAMERA, "diagnostics"),
        subscribe=("diagnostics",),
        get=("clock", "sent/1"),
        reply=("camera/c1/snapshot", "camera/c1/calibrate", "sent/1"),
    ),
    Kind.ROBOT: May(
        put=(*(f"robot/r1/{key}" for key in ROBOTS_OWN), "diagnostics"),
        subscribe=("robot/r1/correction", "robot/r1/pose", "robot/r1/suggestion", "diagnostics"),
        get=("clock", "fusion/map", "sent/1"),
        reply=("sent/1",),
    ),
    Kind.FUSION: May(
        put=(*ESTIMATES, "diagnostics"),
        subscribe=(*SEEN, "robot/r1/odom", "robot/r2/odom", "diagnostics"),
        get=("sent/1",),
        reply=(*FUSION_COMMANDS, "clock", "sent/1"),
    ),
    Kind.RECORDER: May(
        put=("diagnostics",),
        subscribe=DATA,
        get=("fusion/network", "sent/1"),
        reply=("recorder/stop", "sent/1"),
    ),
    Kind.OPERATOR: May(
        subscribe=DATA,
        get=(*CAMERA_COMMANDS, *FUSION_COMMANDS, "recorder/stop", "clock", "sent/1"),
    ),
    Kind.VIEWER: May(subscribe=DATA, get=("sent/1",)),
}
PEOPLE = tuple((kind, name) for kind, name in NODES if kind is not Kind.ROUTER)
_SETTLE_S = 0.4
"""What is wrongly let through comes within a millisecond; it is waited for this long."""
_ANSWER_S = 1.5
_PATIENCE_S = 60.0


@pytest.fixture(
    scope="module",
    params=[
        *("gate, tls", "router, tls", "router, quic"),
        *(pytest.param(f"zenohd, {p}", marks=needs_zenohd) for p in ("tls", "quic")),
    ],
)
def sessions(
    tmp_path_factory: pytest.TempPathFactory,
    free_port: Callable[[], int],
    request: pytest.FixtureRequest,
) -> Iterator[tuple[zenoh.Session, dict[Kind, zenoh.Session]]]:
    """A process of the machine that listens, which may do all, and a client of every kind."""
    door, protocol = request.param.split(", ")
    secured = SecuredSite(tmp_path_factory.mktemp("site"), free_port(), protocol=protocol)
    with ExitStack() as stack:
        if door == "router":
            stack.enter_context(open_router(secured.listening))
        elif door == "zenohd":
            stack.enter_context(secured.zenohd())
        else:
            me = (Kind.FUSION, "fusion")
            stack.enter_context(open_bus(secured.listening, me))
        witness = open_session(session_settings(SITE, secured.listening.bus))
        stack.callback(witness.close)
        clients = {}
        for kind, name in PEOPLE:
            clients[kind] = secured.session(kind, name)
            stack.callback(clients[kind].close)
        met = witness.liveliness()
        token = clients[Kind.CAMERA].liveliness().declare_token(f"{SITE}/alive/edge/c1")
        assert eventually(lambda: len(list(met.get(f"{SITE}/alive/**", timeout=0.5))) == 1)
        token.undeclare()
        yield witness, clients


def full(key: str) -> str:
    return f"{SITE}/{key}"


def cells(verb: str) -> set[tuple[Kind, str]]:
    return {(kind, key) for kind, may in EXPECTED.items() for key in getattr(may, verb)}


class Seen:
    """(kind, key) pairs that happened; filled on Zenoh's threads."""

    def __init__(self) -> None:
        self._lock, self._pairs = threading.Lock(), set[tuple[Kind, str]]()

    def add(self, kind: str, key: str) -> None:
        with self._lock:
            self._pairs.add((Kind(kind), key.removeprefix(f"{SITE}/")))

    def settled(
        self, try_all: Callable[[], None], expected: set[tuple[Kind, str]]
    ) -> set[tuple[Kind, str]]:
        """What happened when all was tried, again where news of who listens was not round yet."""
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try_all()
            time.sleep(_SETTLE_S)
            with self._lock:
                seen = set(self._pairs)
            if seen >= expected or time.monotonic() > deadline:
                return seen


def direct(callback: Callable[..., None]) -> zenoh.handlers.Callback:
    return zenoh.handlers.Callback(callback, indirect=False)


def test_put(sessions: tuple[zenoh.Session, dict[Kind, zenoh.Session]]) -> None:
    witness, clients = sessions
    seen = Seen()
    heard = direct(lambda sample: seen.add(sample.payload.to_string(), str(sample.key_expr)))
    subscriber = witness.declare_subscriber("**", heard)

    def put_all() -> None:
        for kind, client in clients.items():
            for key in KEYS:
                client.put(full(key), str(kind))
                client.delete(full(key))

    assert seen.settled(put_all, cells("put")) == cells("put")
    subscriber.undeclare()


def test_subscribe(sessions: tuple[zenoh.Session, dict[Kind, zenoh.Session]]) -> None:
    witness, clients = sessions
    seen = Seen()
    subscribers = []
    for kind, client in clients.items():
        for key in (*map(full, KEYS), "**", f"{SITE}/**", f"{SITE}/robot/*/correction"):
            heard = direct(lambda sample, kind=kind: seen.add(kind, str(sample.key_expr)))
            subscribers.append(client.declare_subscriber(key, heard))

    def put_all() -> None:
        for key in KEYS:
            witness.put(full(key), "x")

    expected = cells("subscribe")
    assert seen.settled(put_all, expected) == expected
    for subscriber in subscribers:
        subscriber.undeclare()


def test_get(sessions: tuple[zenoh.Session, dict[Kind, zenoh.Session]]) -> None:
    witness, clients = sessions
    served = [
        witness.declare_queryable(full(key), direct(lambda query, key=key: _answer(query, key)))
        for key in KEYS
    ]
    seen = Seen()

    def ask_all() -> None:
        for kind, client in clients.items():
            for key in KEYS:
                _ask(client, key, lambda _text, kind=kind, key=key: seen.add(kind, key))

    expected = cells("get")
    assert seen.settled(ask_all, expected) == expected
    for queryable in served:
        queryable.undeclare()


def test_reply(sessions: tuple[zenoh.Session, dict[Kind, zenoh.Session]]) -> None:
    witness, clients = sessions
    served = [
        client.declare_queryable(full(key), direct(lambda query, kind=kind: _answer(query, kind)))
        for kind, client in clients.items()
        for key in KEYS
    ]
    seen = Seen()

    def ask_all() -> None:
        for key in KEYS:
            _ask(witness, key, lambda text, key=key: seen.add(text, key))

    expected = cells("reply")
    assert seen.settled(ask_all, expected) == expected
    for queryable in served:
        queryable.undeclare()


def _answer(query: zenoh.Query, text: str) -> None:
    with query:
        query.reply(query.key_expr, str(text))


def _ask(session: zenoh.Session, key: str, answered: Callable[[str], None]) -> None:
    def arrived(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            answered(reply.ok.payload.to_string())

    session.get(
        full(key),
        direct(arrived),
        timeout=_ANSWER_S,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
