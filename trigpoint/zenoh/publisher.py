"""A publisher on one key, with the topic's delivery."""

import time
from collections.abc import Callable
from functools import partial

import zenoh
from zenoh import ext

from trigpoint.base.errors import BusError
from trigpoint.bus.bus import Closable
from trigpoint.bus.outbox import Outbox
from trigpoint.bus.reunion import Reunion
from trigpoint.contract.topics import Delivery, Topic

from .datagrams import Datagrams, Lasting
from .session import FLUSH_S, has_link, plain, quality_of

_HEARTBEAT_S = 0.5
_ANNOUNCE_S = 0.05
"""A subscriber that gets a new publisher's live sample before its token takes that sample for the
first, and never asks for the earlier ones (one start in forty, if both begin at the same time)."""

Forget = Callable[[Closable], bool]
"""Tells the bus that a declaration is withdrawn; false if it already was."""


class ZenohPublisher:
    """Sends on one key with the topic's delivery; urgent samples also through `datagrams`."""

    def __init__(
        self,
        session: zenoh.Session,
        topic: Topic,
        key: str,
        outbox: Outbox,
        closed: Forget,
        datagrams: Datagrams | None = None,
    ) -> None:
        self._session, self._key, self._outbox, self._closed = session, key, outbox, closed
        self._matching: zenoh.Publisher | None = None
        self._reunion: Reunion | None = None
        self._is_closed = False
        self._datagrams = datagrams if topic.delivery is Delivery.URGENT else None
        self._copies = self._datagrams.publisher(topic, key) if self._datagrams else None
        quality = quality_of(topic)
        if topic.cache:
            self._publisher = ext.declare_advanced_publisher(
                session,
                key,
                cache=ext.CacheConfig(
                    topic.cache,
                    replies_config=ext.RepliesConfig(
                        congestion_control=quality["congestion_control"]
                    ),
                ),
                sample_miss_detection=ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S
                ),
                publisher_detection=True,
                **quality,
            )
            if topic.delivery is Delivery.RECOVERED:
                time.sleep(_ANNOUNCE_S)
                self._reunion = Reunion(lambda: has_link(session))
        else:
            self._publisher = self._matching = session.declare_publisher(key, **quality)

    def put(self, payload: bytes, *, attachment: bytes = b"") -> None:
        if self._is_closed:
            raise BusError(f"nothing can be sent on {self._key}: its publisher is closed")
        if self._reunion is not None and (wait_s := self._reunion.wait_s) > 0:
            self._outbox.hold(wait_s)
        stamp = None
        if self._datagrams is not None and self._copies is not None:
            stamp = self._session.new_timestamp()  # the same in all copies, so that one counts
            self._datagrams.put(partial(self._send, self._copies, payload, attachment, stamp))
        self._outbox.put(partial(self._send, self._publisher, payload, attachment, stamp))

    def _send(
        self,
        publisher: "zenoh.Publisher | ext.AdvancedPublisher | Lasting",
        payload: bytes,
        attachment: bytes,
        stamp: zenoh.Timestamp | None,
    ) -> None:
        try:
            publisher.put(payload, attachment=attachment or None, timestamp=stamp)
        except zenoh.ZError as reason:
            raise BusError(f"nothing can be sent on {self._key}: {plain(reason)}") from None

    @property
    def has_listener(self) -> bool:
        if self._matching is None:  # an advanced publisher cannot tell; a plain one can
            self._matching = self._session.declare_publisher(self._key)
        status = self._matching.matching_status
        return bool(getattr(status, "matching", status))  # an object, although the stub says bool

    def close(self) -> None:
        if not self._closed(self):
            return
        self._is_closed = True
        self._outbox.flush(FLUSH_S)
        self._publisher.undeclare()
        if self._copies is not None:
            self._copies.undeclare()
        if self._matching is not None and self._matching is not self._publisher:
            self._matching.undeclare()
