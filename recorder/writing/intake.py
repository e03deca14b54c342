"""Passes every valid sample of a site, and no other, from the bus to a recorder or viewer."""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection
from functools import partial

from msgspec.structs import replace

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import BusError, MessageError
from trigpoint.bus.bus import Bus, Sample, Subscription
from trigpoint.contract import cdr
from trigpoint.contract.messages import Message
from trigpoint.contract.topics import IMAGE, TOPICS, Topic, key_matches, node_of, topic_of
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse
from trigpoint.site.config import Site

Take = Callable[[Topic, Sample, Message], None]
Lose = Callable[[str, int], None]

_log = logging.getLogger(__name__)

_PATIENCE_S = 0.2
_CATCH_UP_S = 0.4
_REST_S = 1.5
"""How long a stop may wait for samples in transit (answers take milliseconds unless a session
hangs), and the part of its time kept for what follows."""
_SETTLE_S = 2.0
_LOOK_S = 0.01
"""How long a session's end may wait for the queues to empty, and how often it checks."""
_LEAST_QUEUE = 64
"""The topics' own queues suit readers of the newest sample; here every sample is wanted."""


def recorded_topics(site: Site) -> list[Topic]:
    """The contract's recorded topics; pictures only if the site wants them."""
    pictures = site.recorder.pictures
    return [topic for topic in TOPICS if topic.recorded and (pictures or topic is not IMAGE)]


def is_wanted(site: Site, key: str) -> bool:
    """Whether a key passes the site's recorder filter."""
    rest = key.partition("/")[2]
    wanted = site.recorder.keys
    return not wanted or any(key_matches(one, rest) or key_matches(one, key) for one in wanted)


class Intake:
    """Subscribes to topics, each on its own thread, and passes their valid samples to `take`.

    An invalid sample is rejected and counted, and its sender named in the diagnostics. Samples
    already sent when the node stops are still awaited and passed on.
    """

    def __init__(
        self,
        bus: Bus,
        node: Node,
        site: Site,
        topics: Collection[Topic],
        take: Take,
        lose: Lose = lambda _key, _count: None,
    ) -> None:
        """`lose` gets the number of further samples of a key dropped by the bus's full queue."""
        self._bus, self._node, self._site, self._take, self._lose = bus, node, site, take, lose
        self._is_caught_up = threading.Event()
        self._subscriptions: list[Subscription] = []
        self._handed: Counter[str] = Counter()
        cdr.warm_up()
        for topic in topics:
            deep = replace(topic, queue=max(topic.queue, _LEAST_QUEUE))
            subscription = bus.subscribe(deep, topic.expression(site.name))
            self._subscriptions.append(subscription)
            node.health.watch(topic.name, subscription)
            node.work(topic.name, partial(self._run, topic, subscription))
        node.thread("catches up", self._catch_up)

    def _run(self, topic: Topic, subscription: Subscription, pulse: Pulse) -> None:
        told: dict[str, int] = {}
        while not self._is_caught_up.is_set():
            pulse.beat()
            if sample := subscription.take(_PATIENCE_S):
                self._hand_on(topic, sample)
                self._handed[topic.name] += 1
            self._tell_losses(subscription, told)
        subscription.close()
        while sample := subscription.take(0.0):
            self._hand_on(topic, sample)
        self._tell_losses(subscription, told)

    def settle(self) -> None:
        """Wait until everything sent before is passed on; the topics' threads keep running."""
        self._wait_for_what_is_sent(_CATCH_UP_S)
        came = sum(subscription.received for subscription in self._subscriptions)
        deadline = time.monotonic() + _SETTLE_S
        while self._taken < came and time.monotonic() < deadline:
            time.sleep(_LOOK_S)

    @property
    def _taken(self) -> int:
        """Number of samples passed on, or dropped from a full queue."""
        dropped = sum(sum(one.losses.values()) for one in self._subscriptions)
        return sum(self._handed.values()) + dropped

    def _catch_up(self) -> None:
        """After the node's stop, keep the topics' threads running until all samples are here."""
        self._node.stopping.wait()
        try:
            self._wait_for_what_is_sent(min(_CATCH_UP_S, ENDING.left_s(_REST_S)))
        finally:
            self._is_caught_up.set()

    def _wait_for_what_is_sent(self, within_s: float) -> None:
        try:
            if not self._bus.catch_up(self._site.name, within_s):
                _log.warning("somebody did not say in %.1f s that all it sent is here", within_s)
        except BusError as reason:
            _log.warning("what is still on its way may be missing: %s", reason)

    def _tell_losses(self, subscription: Subscription, told: dict[str, int]) -> None:
        if subscription.dropped == 0:
            return
        for key, count in subscription.losses.items():
            if more := count - told.get(key, 0):
                told[key] = count
                self._lose(key, more)

    def _hand_on(self, topic: Topic, sample: Sample) -> None:
        try:
            message = sound_message(topic, sample, self._site)
        except MessageError as reason:
            self._node.health.reject(sample, reason)
            return
        self._take(topic, sample, message)


def sound_message(topic: Topic, sample: Sample, site: Site) -> Message:
    """The message in a sample; raise MessageError if it does not follow the contract."""
    check_sender(topic, sample, site)
    return cdr.decode(topic.type_name, sample.payload)


def check_sender(topic: Topic, sample: Sample, site: Site) -> None:
    """Raise MessageError where a sample's key or encoding does not follow the contract, or the site
    knows nobody of that name."""
    if topic_of(sample.key) is not topic:
        raise MessageError(f"{sample.key} is not a key of the contract")
    if not topic.may_be(sample.encoding):
        raise MessageError(f"the encoding is «{sample.encoding}», not «{topic.encoding}»")
    name = node_of(sample.key)
    if topic.path.startswith("robot/"):
        kind, known = "robot", site.robots.keys()
    elif "{id}" in topic.path:
        kind, known = "camera", site.cameras.keys()
    else:
        return
    if name not in known:
        raise MessageError(
            f"the site file has no {kind} «{name}»; add it there and start this node again"
        )
