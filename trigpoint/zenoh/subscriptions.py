"""Subscribers that fill a queue from a key expression, with the topic's delivery."""

import time
from collections.abc import Callable

import zenoh
from zenoh import ext

from trigpoint.bus.latest import LatestSamples
from trigpoint.bus.queue import SampleQueue
from trigpoint.bus.urgent import Newest
from trigpoint.contract.topics import Delivery, Topic

from .datagrams import Datagrams
from .past_samples import History
from .session import Arrival, called_at_once

_Queue = SampleQueue[Arrival] | LatestSamples[Arrival]


def subscribe(
    session: zenoh.Session,
    datagrams: Datagrams | None,
    topic: Topic,
    expression: str,
    queue: _Queue,
) -> Callable[[], None]:
    """Declare a subscriber that fills `queue`; return the function that withdraws it.

    On topics with a cache it also gets what the senders keep and what was sent while the link was
    broken; what is lost of this is counted. On urgent ones it also gets the copies sent as
    `datagrams`.
    """
    if topic.delivery is Delivery.URGENT:
        return _subscribe_urgent(session, datagrams, expression, queue)

    def receive(sample: zenoh.Sample) -> None:
        queue.push((time.time_ns(), sample))

    if not topic.cache:
        return session.declare_subscriber(expression, called_at_once(receive)).undeclare
    history = None
    if topic.delivery is Delivery.RECOVERED:  # others keep only the last value
        history = History(session, topic.cache, receive, queue.miss)
    subscriber = ext.declare_advanced_subscriber(
        session,
        expression,
        called_at_once(history.receive if history else receive),
        # A sender that Zenoh detects is asked for all that it keeps, after each break again;
        # History asks only for what is missing.
        history=ext.HistoryConfig(detect_late_publishers=not history, max_samples=topic.cache),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )

    def miss(missed: ext.Miss) -> None:
        queue.miss(missed.nb)

    listener = None if history else subscriber.sample_miss_listener(called_at_once(miss))

    def undeclare() -> None:
        if listener:
            listener.undeclare()
        subscriber.undeclare()
        if history:
            history.close()

    return undeclare


def _subscribe_urgent(
    session: zenoh.Session, datagrams: Datagrams | None, expression: str, queue: _Queue
) -> Callable[[], None]:
    """For samples that arrive by more than one path: the first copy counts."""
    newest = Newest()

    def receive(sample: zenoh.Sample) -> None:
        arrival = (time.time_ns(), sample)
        stamp = sample.timestamp
        if stamp is None:  # its sender makes no copies
            queue.push(arrival)
            return
        sent_ns = stamp.get_time_as_ntp64().as_nanos()
        sender = str(stamp.get_id())
        newest.hand_on(str(sample.key_expr), sender, sent_ns, lambda: queue.push(arrival))

    arrived = called_at_once(receive)
    subscriber = session.declare_subscriber(expression, arrived)
    is_beside = datagrams is not None and datagrams.is_beside
    copies = datagrams.subscriber(expression, arrived) if datagrams and is_beside else None

    def undeclare() -> None:
        subscriber.undeclare()
        if copies is not None:
            copies.undeclare()

    return undeclare
