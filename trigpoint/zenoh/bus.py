"""A Zenoh session as the bus: it withdraws what it declared, and closes within a time limit."""

import threading
import time
from collections.abc import Callable
from typing import TypeVar

import zenoh
from zenoh import CongestionControl

from trigpoint.base.closing import Closing
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import BusError
from trigpoint.bus.bus import COMMAND_TIMEOUT_S, Bell, Closable, Reply
from trigpoint.bus.gate import Gate
from trigpoint.bus.latest import LatestSamples
from trigpoint.bus.outbox import Outbox
from trigpoint.bus.queue import SampleQueue
from trigpoint.bus.server import Server
from trigpoint.contract.topics import Delivery, Topic, sent_key

from .datagrams import Datagrams
from .publisher import Forget, ZenohPublisher
from .session import (
    CLOSE_S,
    FLUSH_S,
    Arrival,
    called_at_once,
    identity_of,
    key_of,
    plain,
    sample_of,
    share_of,
)
from .subscriptions import subscribe

_ERROR_ENCODING = "text/plain"

_MOST_UNSENT = 4096
_OUTBOX = {Delivery.NEWEST: 8}
"""How many samples may wait to be sent, per delivery; of pictures only the newest matter."""
_DIRECT = set(Delivery) - {Delivery.RELIABLE, Delivery.LAST_VALUE}
"""Deliveries sent on the caller's thread. Odometry and sightings come from threads that send
nothing else, nothing is queued ahead of a correction, and droppable samples wait 50 ms at most. All
others are fusion's, whose corrections must not wait for them."""
_LEAST_CLOSE_S = 0.2
_REST_S = 0.2
"""The least time that closing gets, even if a stop leaves none; and the part of a stop's time that
is kept back for what follows."""

_Declared = TypeVar("_Declared", bound=Closable)


class ZenohBus(Closing):
    """Owns an open session; made by `open_bus`."""

    def __init__(
        self,
        session: zenoh.Session,
        *,
        locators: tuple[str, ...] = (),
        connect: tuple[str, ...] = (),
        gate: Gate | None = None,
        warning: Callable[[], str] = str,
        days_left: Callable[[], float | None] = lambda: None,
        datagrams: Datagrams | None = None,
    ) -> None:
        self._datagrams = datagrams
        self._session, self._locators, self._gate = session, locators, gate
        self._warning, self._days_left = warning, days_left
        self._connect = connect
        # One outbox per delivery, so that a blocked delivery holds up no other.
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
        return identity_of(self._session.zid())

    @property
    def locators(self) -> tuple[str, ...]:
        return self._locators

    @property
    def peers(self) -> tuple[str, ...]:
        info = self._session.info
        return tuple(identity_of(zid) for zid in (*info.peers_zid(), *info.routers_zid()))

    @property
    def warning(self) -> str:
        return self._warning()

    @property
    def certificate_days(self) -> float | None:
        return self._days_left()

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
        """Serve the query of `catch_up`: the answer follows the samples on the same path."""
        with self._lock:
            is_new = site not in self._answers_for
            self._answers_for.add(site)
        if is_new:
            self.serve(sent_key(site, self.identity), lambda _request: b"")

    def catch_up(self, site: str, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        # Answers have the priority of the least urgent reliable sample, and a link keeps the order
        # within a priority. If an answer is missing, Zenoh waits for the whole time limit.
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
    ) -> SampleQueue[Arrival]:
        def declare() -> SampleQueue[Arrival]:
            queue = SampleQueue(
                topic.queue,
                sample_of,
                lambda: self._close_once(queue, undeclare),
                key_of=key_of,
                share_of=share_of,
                wanted=wanted,
                in_turns=in_turns,
                bell=bell,
            )
            undeclare = subscribe(self._session, self._datagrams, topic, expression, queue)
            return queue

        return self._declare(expression, declare)

    def latest(self, topic: Topic, expression: str) -> LatestSamples[Arrival]:
        def declare() -> LatestSamples[Arrival]:
            latest = LatestSamples(
                sample_of, lambda: self._close_once(latest, undeclare), key_of=key_of
            )
            undeclare = subscribe(self._session, self._datagrams, topic, expression, latest)
            return latest

        return self._declare(expression, declare)

    def declare_alive(self, key: str) -> Closable:
        def declare() -> _Declaration:
            token = self._session.liveliness().declare_token(key)
            return _Declaration(token.undeclare, self._forget)

        return self._declare(key, declare)

    def alive(self, expression: str, *, timeout_s: float = COMMAND_TIMEOUT_S) -> list[str]:
        try:
            replies = self._session.liveliness().get(expression, timeout=timeout_s)
            return sorted({str(reply.ok.key_expr) for reply in replies if reply.ok is not None})
        except zenoh.ZError as reason:
            raise BusError(f"nobody can be asked about {expression}: {plain(reason)}") from None

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> Closable:
        def declare() -> Server:
            def arrive(query: zenoh.Query) -> None:
                server.submit(_Request(key, query))

            server = Server(key, answer)
            try:
                queryable = self._session.declare_queryable(key, called_at_once(arrive))
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
            raise BusError(f"{key} cannot be asked: {plain(reason)}") from None
        return [answer for answer in answers if answer is not None]

    def close(self) -> None:
        """Withdraw every declaration, the latest first, and close the session.

        Zenoh waits for peers that have connected and stay silent (measured: 9.5 s for five idle TCP
        connections); a process that must end leaves such a session behind.
        """
        thread = threading.Thread(target=self._close, name="bus closes", daemon=True)
        thread.start()
        thread.join(max(_LEAST_CLOSE_S, min(CLOSE_S, ENDING.left_s(_REST_S))))
        if thread.is_alive():
            ENDING.leave_behind("the bus's session")

    def _close(self) -> None:
        try:
            for declared in reversed(list(self._declared.values())):
                declared.close()
            for outbox in self._outboxes.values():
                outbox.close(FLUSH_S)
            if self._datagrams is not None:
                self._datagrams.close()
        finally:
            if self._gate is not None:
                self._gate.close()
            self._session.close()

    def _declare(self, key: str, declare: Callable[[], _Declared]) -> _Declared:
        try:
            declared = declare()
        except zenoh.ZError as reason:
            raise BusError(f"{key} cannot be declared: {plain(reason)}") from None
        with self._lock:
            self._declared[id(declared)] = declared
        return declared

    def _forget(self, declared: Closable) -> bool:
        with self._lock:
            return self._declared.pop(id(declared), None) is not None

    def _close_once(self, declared: Closable, undeclare: Callable[[], None]) -> None:
        if self._forget(declared):
            undeclare()


class _Declaration:
    """A declaration that is withdrawn only once."""

    def __init__(self, undeclare: Callable[[], None], closed: "Forget") -> None:
        self._undeclare, self._closed = undeclare, closed

    def close(self) -> None:
        if self._closed(self):
            self._undeclare()


class _Request:
    """A query waiting in a Server's queue."""

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


def _reply_of(key: str, reply: zenoh.Reply) -> Reply | None:
    """A reply; None for Zenoh's own timeout error, the only one that is not text."""
    if reply.ok is not None:
        return Reply(str(reply.ok.key_expr), reply.ok.payload.to_bytes())
    assert reply.err is not None
    if str(reply.err.encoding) != _ERROR_ENCODING:
        return None
    return Reply(key, b"", reply.err.payload.to_bytes().decode(errors="replace"))
