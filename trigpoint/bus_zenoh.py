"""The bus over Zenoh; the one place that knows zenoh.

Callbacks run on Zenoh's receiving thread (`indirect=False`) and only append to a queue of ours:
measured with an interpreter busy elsewhere, the worst wait was 12 ms, where Zenoh's own callback
threads with their unbounded queues took 44 to 410 ms and kept the program from ending.
"""

import json
import logging
import math
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import Self, TypeVar

import zenoh
from zenoh import CongestionControl, Priority, Reliability, ext

from .access import Kind
from .bus import COMMAND_TIMEOUT_S, Bell, Closable, Reply, Sample
from .bus_gate import Gate
from .bus_keeper import LOST_S, Keeper, close_in_time
from .bus_opening import means_of, open_patiently, settle
from .bus_outbox import Outbox
from .bus_queue import SampleQueue
from .bus_reunion import Reunion
from .bus_server import Server
from .bus_settings import (
    Settings,
    datagram_settings,
    has_datagrams,
    router_settings,
    session_settings,
)
from .bus_urgent import AGAIN_S, WAITING, Newest
from .config import Site
from .ending import ENDING
from .errors import BusError
from .topics import Delivery, Topic, key_matches, recovered_keys, sent_key

_log = logging.getLogger(__name__)

_SWITCH_INTERVAL_S = 0.001
_HEARTBEAT_S = 0.5
_DATAGRAM_PATIENCE_S = 5.0
"""How long opening tries to have datagrams; a firewall may let none through."""
_ANNOUNCE_S = 0.05
"""A subscriber that meets a new publisher's live sample before its token takes that for the first
one and never asks for those before (one of forty starts, when both begin in the same moment)."""
_ERROR_ENCODING = "text/plain"

_MOST_UNSENT = 4096
_OUTBOX = {Delivery.NEWEST: 8}
"""How many samples of a delivery wait to be sent; of pictures the newest are wanted."""
_DIRECT = set(Delivery) - {Delivery.RELIABLE, Delivery.LAST_VALUE}
"""What is sent on the caller's thread: odometry and sightings come from threads that have nothing
else to send, nothing is before a correction, and what may be dropped waits 50 ms at most. All else
is fusion's, whose corrections must not wait for it."""
_FLUSH_S = 0.5
_CLOSE_S = 5.0
_LEAST_CLOSE_S = 0.2
_REST_S = 0.2
"""How long closing may take: where nobody told the process to stop, at least, and what is kept of
the time that a stop may take."""

_QOS: dict[Delivery, tuple[CongestionControl, Priority, bool]] = {
    Delivery.NEWEST: (CongestionControl.DROP, Priority.BACKGROUND, False),
    Delivery.RECOVERED: (CongestionControl.BLOCK, Priority.DATA_HIGH, False),
    Delivery.LAST_VALUE: (CongestionControl.BLOCK, Priority.DATA, False),
    Delivery.RELIABLE: (CongestionControl.BLOCK, Priority.DATA, False),
    Delivery.URGENT: (CongestionControl.BLOCK, Priority.REAL_TIME, True),
    Delivery.BEST_EFFORT: (CongestionControl.DROP, Priority.DATA_LOW, False),
}
"""Congestion, priority, express. BLOCK is for small control data: DROP would lose the newest."""

_Arrival = tuple[int, zenoh.Sample]
_Declared = TypeVar("_Declared", bound=Closable)
_Said = TypeVar("_Said")


def open_bus(
    site: Site, me: tuple[Kind, str] | None = None, *, patience_s: float = math.inf
) -> "ZenohBus":
    """Open the bus by the site's `[bus]`; raise BusError where that is not possible.

    `me`: whose certificate is shown where the site is secured; None: the operator's or viewer's who
    sits here. A client whose endpoint cannot be reached tries again for `patience_s`, which the log
    says.
    """
    means = means_of(site, me)
    settings = session_settings(site.name, site.bus, means.files)
    session = open_patiently(lambda: open_session(settings), settings, patience_s)
    try:
        gate = None
        if settings.gate and means.keeps_gate:
            gate = Gate(
                settings.gate,
                lambda: open_session(settings.gate_settings(means.door())),
                rules=means.rules,
            )
        bus = ZenohBus(
            session,
            locators=settings.locators,
            connect=settings.connect,
            gate=gate,
            warning=means.warning,
            datagrams=_datagrams(site, settings, session),
            named=recovered_keys(site.name, site.cameras, site.robots),
        )
    except BaseException:
        session.close()
        raise
    if settings.meets_others:
        settle(bus)
    return bus


def _datagrams(site: Site, settings: Settings, session: zenoh.Session) -> "Datagrams | None":
    """What sends datagrams, by the given session or one beside it; None where nothing does."""
    if not has_datagrams(site.bus):
        return None
    beside = datagram_settings(site.bus, settings)
    if beside is None:
        return Datagrams(session, is_beside=False)
    try:
        opened = open_patiently(lambda: open_session(beside), beside, _DATAGRAM_PATIENCE_S)
        return Datagrams(
            opened,
            is_beside=True,
            connect=beside.connect,
            reopen=lambda: open_session(beside),
            main=session,
        )
    except BusError as reason:
        _log.warning("%s; until the next start corrections go without datagrams", reason)
        return None


def open_router(site: Site, *others: Site) -> "ZenohBus":
    """Open the bus as the site's router: whoever connects to it reaches everyone else. `others`:
    further sites whose nodes it lets in, each to its own keys."""
    means = means_of(site, None, is_router=True, others=others)
    rate = site.router.picture_rate
    settings = router_settings(site.name, site.bus, means.door(), picture_rate=rate)
    session = open_session(settings)
    return ZenohBus(session, locators=site.bus.listen, warning=means.warning)


def open_session(settings: Settings) -> zenoh.Session:
    """Open a Zenoh session; raise BusError."""
    # The receiving threads wait this long for the interpreter when another thread computes.
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    config = zenoh.Config()
    try:
        for key, value in settings.values().items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as reason:
        if settings.mode == "client":
            names = ", ".join(settings.connect)
            raise BusError(f"the bus cannot reach {names} (bus.connect)") from None
        raise BusError(f"the bus cannot be opened: {_plain(reason)}") from None


def _plain(error: zenoh.ZError) -> str:
    """Zenoh's text without the places in its source."""
    return str(error).partition(" at /")[0].replace("\n", " ").rstrip("! ")


def _sample_of(arrival: _Arrival) -> Sample:
    received_ns, raw = arrival
    stamp, source, attachment = raw.timestamp, raw.source_info, raw.attachment
    if source is not None:
        sender = _identity(source.source_id.zid)
    else:
        sender = _identity(stamp.get_id()) if stamp is not None else ""
    return Sample(
        key=str(raw.key_expr),
        payload=raw.payload.to_bytes(),
        encoding=str(raw.encoding),
        published_ns=stamp.get_time_as_ntp64().as_nanos() if stamp is not None else received_ns,
        received_ns=received_ns,
        attachment=attachment.to_bytes() if attachment is not None else b"",
        sender=sender,
    )


def _identity(identifier: object) -> str:
    return str(identifier).lstrip("0")


def _share_of(arrival: _Arrival) -> str:
    """Who is to have a share of a queue: a sender on a key."""
    stamp = arrival[1].timestamp
    return f"{arrival[1].key_expr} {stamp.get_id() if stamp is not None else ''}"


def _key_of(arrival: _Arrival) -> str:
    return str(arrival[1].key_expr)


def _has_link(session: zenoh.Session) -> bool:
    info = session.info
    return bool(info.routers_zid() or info.peers_zid())


class _Lasting:
    """A publisher or subscriber that is declared anew on a session that takes another's place."""

    def __init__(
        self,
        lock: threading.Lock,
        declare: Callable[[zenoh.Session], "zenoh.Publisher | zenoh.Subscriber[None]"],
        session: zenoh.Session,
    ) -> None:
        self._lock, self._declare, self._now = lock, declare, declare(session)
        self.is_closed = False

    def move(self, session: zenoh.Session) -> None:
        """Go on by another session; called with the lock."""
        if not self.is_closed:
            self._now = self._declare(session)

    def put(
        self, payload: bytes, *, attachment: bytes | None, timestamp: zenoh.Timestamp | None
    ) -> None:
        with self._lock:
            assert isinstance(self._now, zenoh.Publisher)
            self._now.put(payload, attachment=attachment, timestamp=timestamp)

    def undeclare(self) -> None:
        with self._lock:
            self.is_closed = True
            self._now.undeclare()


class Datagrams:
    """Sends copies that may be lost, each twice. `session`: beside the bus's own, or that one;
    `connect`: where the one beside connects to; `reopen`: opens it anew, which is done where it
    has lost its datagrams for `lost_s` while `main`, the bus's own, reaches somebody."""

    def __init__(
        self,
        session: zenoh.Session,
        *,
        is_beside: bool,
        connect: tuple[str, ...] = (),
        reopen: Callable[[], zenoh.Session] | None = None,
        main: zenoh.Session | None = None,
        lost_s: float = LOST_S,
    ) -> None:
        self._session, self.is_beside, self._connect = session, is_beside, connect
        self._again = Outbox("bus sends again", WAITING)
        self._lock = threading.Lock()
        self._declared: list[_Lasting] = []
        self._is_closed = self._was_shared = False
        self._reopen, self._main, self._keeper = reopen, main, None
        if reopen is not None and main is not None:
            self._keeper = Keeper("bus keeps datagrams", self._is_well, self._renew, lost_s=lost_s)

    def publisher(self, topic: Topic, key: str) -> _Lasting:
        _, priority, express = _QOS[topic.delivery]
        return self._lasting(
            lambda session: session.declare_publisher(
                key,
                encoding=topic.encoding,
                congestion_control=CongestionControl.DROP,
                priority=priority,
                express=express,
                reliability=Reliability.BEST_EFFORT,
            )
        )

    def subscriber(
        self, expression: str, handler: "zenoh.handlers.Callback[zenoh.Sample]"
    ) -> _Lasting:
        return self._lasting(lambda session: session.declare_subscriber(expression, handler))

    def _lasting(
        self, declare: Callable[[zenoh.Session], "zenoh.Publisher | zenoh.Subscriber[None]"]
    ) -> _Lasting:
        with self._lock:
            self._declared = [item for item in self._declared if not item.is_closed]
            item = _Lasting(self._lock, declare, self._session)
            self._declared.append(item)
        return item

    @property
    def unreached(self) -> tuple[str, ...]:
        """Where nobody answers now."""
        return self._connect if self._connect and not _has_link(self._session) else ()

    def _is_well(self) -> bool:
        """Whether datagrams have a link, to the router of the bus's own session where they had
        that; also while that one reaches nobody, since nothing can be done then."""
        assert self._main is not None
        there = {str(link.zid) for link in self._main.info.links()}
        if not there:
            return True
        links = self._session.info.links()
        mine = {str(link.zid) for link in links if link.reliability != Reliability.RELIABLE}
        if mine & there:
            self._was_shared = True
        return bool(mine & there if self._was_shared else mine)

    def _renew(self) -> None:
        assert self._reopen is not None
        session = self._reopen()
        try:
            with self._lock:
                if not self._is_closed:
                    session, self._session = self._session, session
                    self._was_shared = False
                    for item in self._declared:
                        item.move(self._session)
                    _log.warning("the session for datagrams had lost them and was opened anew")
        except zenoh.ZError as reason:
            raise BusError(f"datagrams cannot be declared anew: {_plain(reason)}") from None
        finally:
            close_in_time(session.close, "a session for datagrams")

    def put(self, send: Callable[[], None]) -> None:
        """Send now, and soon again."""
        send()
        if not self._again.waiting:
            self._again.hold(AGAIN_S)
        self._again.put(send)

    def close(self) -> None:
        self._again.close(_FLUSH_S)
        with self._lock:
            self._is_closed = True
        if self._keeper is not None and not self._keeper.close(_CLOSE_S):
            ENDING.leave_behind("a session for datagrams")
        if self.is_beside:
            self._session.close()


class ZenohPublisher:
    """Sends on one key with the topic's delivery; what is urgent by `datagrams` as well."""

    def __init__(
        self,
        session: zenoh.Session,
        topic: Topic,
        key: str,
        outbox: Outbox,
        closed: "_Closed",
        datagrams: Datagrams | None = None,
    ) -> None:
        self._session, self._key, self._outbox, self._closed = session, key, outbox, closed
        self._matching: zenoh.Publisher | None = None
        self._reunion: Reunion | None = None
        self._is_closed = False
        self._datagrams = datagrams if topic.delivery is Delivery.URGENT else None
        self._copies = self._datagrams.publisher(topic, key) if self._datagrams else None
        congestion, priority, express = _QOS[topic.delivery]
        reliability = (
            Reliability.RELIABLE if topic.delivery.is_reliable else Reliability.BEST_EFFORT
        )
        if topic.cache:
            self._publisher = ext.declare_advanced_publisher(
                session,
                key,
                encoding=topic.encoding,
                congestion_control=congestion,
                priority=priority,
                express=express,
                reliability=reliability,
                cache=ext.CacheConfig(
                    topic.cache, replies_config=ext.RepliesConfig(congestion_control=congestion)
                ),
                sample_miss_detection=ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S
                ),
                publisher_detection=True,
            )
            if topic.delivery is Delivery.RECOVERED:
                time.sleep(_ANNOUNCE_S)
                self._reunion = Reunion(lambda: _has_link(session))
        else:
            self._publisher = self._matching = session.declare_publisher(
                key,
                encoding=topic.encoding,
                congestion_control=congestion,
                priority=priority,
                express=express,
                reliability=reliability,
            )

    def put(self, payload: bytes, *, attachment: bytes = b"") -> None:
        if self._is_closed:
            raise BusError(f"nothing can be sent on {self._key}: its publisher is closed")
        if self._reunion is not None and (wait_s := self._reunion.wait_s) > 0:
            self._outbox.hold(wait_s)
        stamp = None
        if self._datagrams is not None and self._copies is not None:
            stamp = self._session.new_timestamp()  # by which the copies are known for one
            self._datagrams.put(partial(self._send, self._copies, payload, attachment, stamp))
        self._outbox.put(partial(self._send, self._publisher, payload, attachment, stamp))

    def _send(
        self,
        publisher: "zenoh.Publisher | ext.AdvancedPublisher | _Lasting",
        payload: bytes,
        attachment: bytes,
        stamp: zenoh.Timestamp | None,
    ) -> None:
        try:
            publisher.put(payload, attachment=attachment or None, timestamp=stamp)
        except zenoh.ZError as reason:
            raise BusError(f"nothing can be sent on {self._key}: {_plain(reason)}") from None

    @property
    def has_listener(self) -> bool:
        if self._matching is None:  # an advanced publisher does not say; a plain one beside it does
            self._matching = self._session.declare_publisher(self._key)
        status = self._matching.matching_status
        return bool(getattr(status, "matching", status))  # an object, though its stub says bool

    def close(self) -> None:
        if not self._closed(self):
            return
        self._is_closed = True
        self._outbox.flush(_FLUSH_S)
        self._publisher.undeclare()
        if self._copies is not None:
            self._copies.undeclare()
        if self._matching is not None and self._matching is not self._publisher:
            self._matching.undeclare()


def _subscribe_urgent(
    session: zenoh.Session,
    datagrams: Datagrams | None,
    expression: str,
    queue: SampleQueue[_Arrival],
) -> Callable[[], None]:
    """As `_subscribe`, for what comes by more than one way: the first copy counts."""
    newest = Newest()

    def receive(sample: zenoh.Sample) -> None:
        arrival = (time.time_ns(), sample)
        stamp = sample.timestamp
        if stamp is None:  # of a sender that makes no copies
            queue.push(arrival)
            return
        sent_ns = stamp.get_time_as_ntp64().as_nanos()
        sender = str(stamp.get_id())
        newest.hand_on(str(sample.key_expr), sender, sent_ns, lambda: queue.push(arrival))

    arrived = _called_at_once(receive)
    subscriber = session.declare_subscriber(expression, arrived)
    is_beside = datagrams is not None and datagrams.is_beside
    copies = datagrams.subscriber(expression, arrived) if datagrams and is_beside else None

    def undeclare() -> None:
        subscriber.undeclare()
        if copies is not None:
            copies.undeclare()

    return undeclare


def _subscribe(
    session: zenoh.Session,
    topic: Topic,
    expression: str,
    queue: SampleQueue[_Arrival],
    named: frozenset[str],
) -> Callable[[], None]:
    """Declare what fills `queue`; return what takes it back.

    What is recovered after a break has a subscriber for each of the `named` keys, and what others
    send is taken as it comes. One for all of them hands on only the end of a sender's history where
    the answer about another's ends meanwhile: 23 of 120 starts lost up to 288 of 300 messages,
    which nothing counted; with one for each key, none of 150 did (zenoh-ext 1.10.2).
    """

    def receive(sample: zenoh.Sample) -> None:
        queue.push((time.time_ns(), sample))

    def receive_of_others(sample: zenoh.Sample) -> None:
        if str(sample.key_expr) not in named:
            receive(sample)

    if not topic.cache:
        return session.declare_subscriber(expression, _called_at_once(receive)).undeclare
    if not named:
        return _subscribe_with_history(session, topic, expression, receive, queue)
    undeclare = ExitStack()
    for key in sorted(named):
        undeclare.callback(_subscribe_with_history(session, topic, key, receive, queue))
    others = session.declare_subscriber(expression, _called_at_once(receive_of_others))
    undeclare.callback(others.undeclare)
    return undeclare.close


def _subscribe_with_history(
    session: zenoh.Session,
    topic: Topic,
    expression: str,
    receive: Callable[[zenoh.Sample], None],
    queue: SampleQueue[_Arrival],
) -> Callable[[], None]:
    """Of what the senders keep, and of what was sent during a break, too; return what takes it
    back."""
    subscriber = ext.declare_advanced_subscriber(
        session,
        expression,
        _called_at_once(receive),
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=topic.cache),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )

    def miss(missed: ext.Miss) -> None:
        queue.miss(missed.nb)

    listener = subscriber.sample_miss_listener(_called_at_once(miss))

    def undeclare() -> None:
        listener.undeclare()
        subscriber.undeclare()

    return undeclare


def _called_at_once(function: Callable[[_Said], None]) -> "zenoh.handlers.Callback[_Said]":
    """On the thread that receives."""
    return zenoh.handlers.Callback(function, indirect=False)


class _Request:
    """A query that waits in a Server's queue."""

    def __init__(self, key: str, query: zenoh.Query) -> None:
        self._key, self._query = key, query

    @property
    def payload(self) -> bytes:
        payload = self._query.payload
        return payload.to_bytes() if payload is not None else b""

    def reply(self, payload: bytes) -> None:
        with self._query:
            self._query.reply(self._key, payload)

    def refuse(self, error: str) -> None:
        with self._query:
            self._query.reply_err(error, encoding=_ERROR_ENCODING)


class _Declaration:
    """Takes something back once."""

    def __init__(self, undeclare: Callable[[], None], closed: "_Closed") -> None:
        self._undeclare, self._closed = undeclare, closed

    def close(self) -> None:
        if self._closed(self):
            self._undeclare()


_Closed = Callable[[Closable], bool]
"""Tells the bus that a declaration is taken back; false where that was done before."""


class ZenohBus:
    """An open session, which it owns; made by `open_bus`."""

    def __init__(
        self,
        session: zenoh.Session,
        *,
        locators: tuple[str, ...] = (),
        connect: tuple[str, ...] = (),
        gate: Gate | None = None,
        warning: Callable[[], str] = str,
        datagrams: Datagrams | None = None,
        named: frozenset[str] = frozenset(),
    ) -> None:
        """`named`: the keys of the site's own cameras and robots."""
        self._datagrams, self._named = datagrams, named
        self._session, self._locators, self._gate = session, locators, gate
        self._warning = warning
        self._connect = connect
        # What one delivery waits for holds up no other.
        self._outboxes = {
            delivery: Outbox(
                f"bus sends: {delivery.value}",
                _OUTBOX.get(delivery, _MOST_UNSENT),
                is_direct=delivery in _DIRECT,
            )
            for delivery in Delivery
        }
        self._lock = threading.Lock()
        self._declared: dict[int, Closable] = {}
        self._answers_for: set[str] = set()

    @property
    def identity(self) -> str:
        return _identity(self._session.zid())

    @property
    def locators(self) -> tuple[str, ...]:
        return self._locators

    @property
    def peers(self) -> tuple[str, ...]:
        info = self._session.info
        return tuple(_identity(zid) for zid in (*info.peers_zid(), *info.routers_zid()))

    @property
    def warning(self) -> str:
        return self._warning()

    @property
    def unreached(self) -> tuple[str, ...]:
        missing = self._connect if self._connect and not self.peers else ()
        return (*missing, *(self._datagrams.unreached if self._datagrams else ()))

    @property
    def unsent(self) -> int:
        return sum(outbox.lost for outbox in self._outboxes.values())

    def flush(self, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        outboxes = self._outboxes.values()
        return all(outbox.flush(max(0.0, deadline - time.monotonic())) for outbox in outboxes)

    def publisher(self, topic: Topic, key: str) -> ZenohPublisher:
        outbox = self._outboxes[topic.delivery]
        if topic.delivery.is_reliable:
            self._answer_what_is_sent(key.partition("/")[0])
        return self._declare(
            key,
            lambda: ZenohPublisher(
                self._session, topic, key, outbox, self._forget, self._datagrams
            ),
        )

    def _answer_what_is_sent(self, site: str) -> None:
        """Serve what `catch_up` asks for: an answer takes the way of the samples, behind them."""
        with self._lock:
            is_new = site not in self._answers_for
            self._answers_for.add(site)
        if is_new:
            self.serve(sent_key(site, self.identity), lambda _request: b"")

    def catch_up(self, site: str, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        # Answers have the priority of the least urgent sample that must arrive; on a link nothing
        # overtakes what is as urgent. Where one does not come, Zenoh waits until the time is over.
        self.query(sent_key(site, "*"), timeout_s=timeout_s)
        return time.monotonic() < deadline

    def subscribe(
        self,
        topic: Topic,
        expression: str,
        *,
        wanted: Callable[[str], bool] | None = None,
        in_turns: bool = False,
        bell: Bell | None = None,
    ) -> SampleQueue[_Arrival]:
        def declare() -> SampleQueue[_Arrival]:
            queue = SampleQueue(
                topic.queue,
                _sample_of,
                lambda: self._close_once(queue, undeclare),
                key_of=_key_of,
                share_of=_share_of,
                wanted=wanted,
                in_turns=in_turns,
                bell=bell,
            )
            if topic.delivery is Delivery.URGENT:
                undeclare = _subscribe_urgent(self._session, self._datagrams, expression, queue)
            else:
                named = frozenset(
                    key for key in self._named if topic.match(key) and key_matches(expression, key)
                )
                undeclare = _subscribe(self._session, topic, expression, queue, named)
            return queue

        return self._declare(expression, declare)

    def declare_alive(self, key: str) -> Closable:
        def declare() -> _Declaration:
            token = self._session.liveliness().declare_token(key)
            return _Declaration(token.undeclare, self._forget)

        return self._declare(key, declare)

    def alive(self, expression: str, *, timeout_s: float = 1.0) -> list[str]:
        try:
            replies = self._session.liveliness().get(expression, timeout=timeout_s)
            return sorted({str(reply.ok.key_expr) for reply in replies if reply.ok is not None})
        except zenoh.ZError as reason:
            raise BusError(f"nobody can be asked about {expression}: {_plain(reason)}") from None

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> Closable:
        def declare() -> Server:
            def arrive(query: zenoh.Query) -> None:
                server.submit(_Request(key, query))

            server = Server(key, answer)
            try:
                queryable = self._session.declare_queryable(key, _called_at_once(arrive))
            except zenoh.ZError:
                server.close()
                raise
            server.undeclare = lambda: self._close_once(server, queryable.undeclare)
            return server

        return self._declare(key, declare)

    def query(
        self, key: str, payload: bytes = b"", *, timeout_s: float = COMMAND_TIMEOUT_S
    ) -> list[Reply]:
        try:
            replies = self._session.get(
                key,
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=CongestionControl.BLOCK,
            )
            answers = [_reply_of(key, reply) for reply in replies]
        except zenoh.ZError as reason:
            raise BusError(f"{key} cannot be asked: {_plain(reason)}") from None
        return [answer for answer in answers if answer is not None]

    def close(self) -> None:
        """Take back every declaration, the latest first, and close the session.

        Zenoh waits for whoever has connected and says nothing (measured: 9.5 s for five idle TCP
        connections); a process that is to end leaves such a session behind.
        """
        thread = threading.Thread(target=self._close, name="bus closes", daemon=True)
        thread.start()
        thread.join(max(_LEAST_CLOSE_S, min(_CLOSE_S, ENDING.left_s(_REST_S))))
        if thread.is_alive():
            ENDING.leave_behind("the bus's session")

    def _close(self) -> None:
        try:
            for declared in reversed(list(self._declared.values())):
                declared.close()
            for outbox in self._outboxes.values():
                outbox.close(_FLUSH_S)
            if self._datagrams is not None:
                self._datagrams.close()
        finally:
            if self._gate is not None:
                self._gate.close()
            self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _declare(self, key: str, declare: Callable[[], _Declared]) -> _Declared:
        try:
            declared = declare()
        except zenoh.ZError as reason:
            raise BusError(f"{key} cannot be declared: {_plain(reason)}") from None
        with self._lock:
            self._declared[id(declared)] = declared
        return declared

    def _forget(self, declared: Closable) -> bool:
        with self._lock:
            return self._declared.pop(id(declared), None) is not None

    def _close_once(self, declared: Closable, undeclare: Callable[[], None]) -> None:
        if self._forget(declared):
            undeclare()


def _reply_of(key: str, reply: zenoh.Reply) -> Reply | None:
    """A reply; None for Zenoh's own note that the time is over, the only error without a text."""
    if reply.ok is not None:
        return Reply(str(reply.ok.key_expr), reply.ok.payload.to_bytes())
    assert reply.err is not None
    if str(reply.err.encoding) != _ERROR_ENCODING:
        return None
    return Reply(key, b"", reply.err.payload.to_bytes().decode(errors="replace"))
