"""What fills a queue with what comes on a key expression, as the topic's delivery asks for it."""

import time
from collections.abc import Callable
from contextlib import ExitStack

import zenoh
from zenoh import ext

from trigpoint.bus_queue import SampleQueue
from trigpoint.bus_urgent import Newest
from trigpoint.topics import Topic

from .datagrams import Datagrams
from .session import Arrival, called_at_once


def subscribe(
    session: zenoh.Session,
    topic: Topic,
    expression: str,
    queue: SampleQueue[Arrival],
    named: frozenset[str],
) -> Callable[[], None]:
    """Declare what fills `queue`; return what takes it back.

    What is recovered after a break has a subscriber for each of the `named` keys, and what others
    send is taken as it comes. One for all of them hands on only the end of a sender's history where
    the answer about another's ends meanwhile: 23 of 120 starts lost up to 288 of 300 messages,
    which nothing counted; with one for each key, none of 150 did (zenoh-ext 1.10.2). Two senders
    with a history on one key would bring that back; whoever comes second is refused (`peers`).
    """

    def receive(sample: zenoh.Sample) -> None:
        queue.push((time.time_ns(), sample))

    def receive_of_others(sample: zenoh.Sample) -> None:
        if str(sample.key_expr) not in named:
            receive(sample)

    if not topic.cache:
        return session.declare_subscriber(expression, called_at_once(receive)).undeclare
    if not named:
        return _subscribe_with_history(session, topic, expression, receive, queue)
    undeclare = ExitStack()
    for key in sorted(named):
        undeclare.callback(_subscribe_with_history(session, topic, key, receive, queue))
    others = session.declare_subscriber(expression, called_at_once(receive_of_others))
    undeclare.callback(others.undeclare)
    return undeclare.close


def _subscribe_with_history(
    session: zenoh.Session,
    topic: Topic,
    expression: str,
    receive: Callable[[zenoh.Sample], None],
    queue: SampleQueue[Arrival],
) -> Callable[[], None]:
    """Of what the senders keep, and of what was sent during a break, too; return what takes it
    back."""
    subscriber = ext.declare_advanced_subscriber(
        session,
        expression,
        called_at_once(receive),
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=topic.cache),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )

    def miss(missed: ext.Miss) -> None:
        queue.miss(missed.nb)

    listener = subscriber.sample_miss_listener(called_at_once(miss))

    def undeclare() -> None:
        listener.undeclare()
        subscriber.undeclare()

    return undeclare


def subscribe_urgent(
    session: zenoh.Session,
    datagrams: Datagrams | None,
    expression: str,
    queue: SampleQueue[Arrival],
) -> Callable[[], None]:
    """As `subscribe`, for what comes by more than one way: the first copy counts."""
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

    arrived = called_at_once(receive)
    subscriber = session.declare_subscriber(expression, arrived)
    is_beside = datagrams is not None and datagrams.is_beside
    copies = datagrams.subscriber(expression, arrived) if datagrams and is_beside else None

    def undeclare() -> None:
        subscriber.undeclare()
        if copies is not None:
            copies.undeclare()

    return undeclare
