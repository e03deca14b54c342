"""A publisher on one key, with the topic's delivery."""

from collections.abc import Callable
from functools import partial

import zenoh
from zenoh import ext

from trigpoint.base.errors import BusError
from trigpoint.bus.bus import Closable
from trigpoint.bus.outbox import Outbox
from trigpoint.contract.topics import Delivery, Topic

from .datagrams import Datagrams, Lasting
from .session import FLUSH_S, plain, quality_of

_DETECTION = {
    Delivery.RECOVERED: ext.MissDetectionConfig(heartbeat=1.0, sporadic_heartbeat=None),
    Delivery.LAST_VALUE: ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
}
"""How subscribers learn that the latest sample is missing. Who fell silent during a break has to go
on telling; of a last value its sender's token is enough."""

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
                sample_miss_detection=_DETECTION[topic.delivery],
                publisher_detection=True,
                **quality,
            )
        else:
            self._publisher = self._matching = session.declare_publisher(key, **quality)

    def put(self, payload: bytes, *, attachment: bytes = b"") -> None:
        if self._is_closed:
            raise BusError(f"nothing can be sent on {self._key}: its publisher is closed")
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
