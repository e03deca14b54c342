"""Receives the estimator's input from the bus."""

from collections.abc import Iterator

from msgspec.structs import replace

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bell, Bus, Sample, Subscription
from trigpoint.contract import cdr, topics
from trigpoint.contract.clock_doubt import DoubtFilter
from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    Message,
    Odometry,
    Sightings,
    stamped,
)
from trigpoint.contract.topics import DIAGNOSTICS, Topic
from trigpoint.node.node import Node

from .delays import Delays
from .diagnostics import Diagnostics as InputDiagnostics
from .intake.admission import Admission

# Samples are taken in for at most this long at once, and at most this many of a topic.
_TAKING_NS = to_ns(0.05)
_MOST_AT_ONCE = 512

Input = CameraInfo | Odometry | Sightings
INPUT_TOPICS: dict[type[Message], Topic] = {
    Odometry: topics.ODOMETRY,
    CameraInfo: topics.CAMERA_INFO,
    Sightings: topics.SIGHTINGS,
}


class Inbox:
    """Odometry, camera_info and sightings of a site, and the diagnostics of who cannot be relied
    on, as they come. Used by one thread at a time. `delays`: of what came."""

    def __init__(
        self,
        bus: Bus,
        node: Node,
        clock: Clock,
        admission: Admission,
        diagnostics: InputDiagnostics,
    ) -> None:
        self._bus, self._node, self._clock = bus, node, clock
        self._admission, self._diagnostics = admission, diagnostics
        self.delays = Delays(node.health, clock)
        self._subscriptions: list[tuple[Topic, Subscription]] = []
        self._news = Bell()
        self._doubts = DoubtFilter()

    def open(self, site: str) -> None:
        """Subscribe."""
        for topic in INPUT_TOPICS.values():
            expression = topic.expression(site)
            subscription = self._bus.subscribe(
                topic, expression, wanted=self._admission.knows, in_turns=True, bell=self._news
            )
            self._subscriptions.append((topic, subscription))
            self._node.health.watch(topic.name, subscription)
        told = self._bus.subscribe(DIAGNOSTICS, DIAGNOSTICS.key(site), bell=self._news)
        self._subscriptions.append((DIAGNOSTICS, told))

    def wait(self, timeout_s: float) -> None:
        """Wait until something comes, or the time is over."""
        self._news.wait(timeout_s)

    @property
    def is_empty(self) -> bool:
        """Whether no sample waits."""
        return not any(subscription.depth for _, subscription in self._subscriptions)

    def messages(self) -> Iterator[tuple[Sample, Input | Diagnostics]]:
        """What has come and is accepted, the topics in turn; bounded in number and time, so that
        more may wait."""
        for topic, sample in self._samples():
            found = self._accepted(topic, sample)
            if found is not None:
                yield found

    def _samples(self) -> Iterator[tuple[Topic, Sample]]:
        until_ns = self._clock.elapsed_ns() + _TAKING_NS
        waiting = self._subscriptions
        for _ in range(_MOST_AT_ONCE):
            found = [(pair, sample) for pair in waiting if (sample := pair[1].take(0.0))]
            yield from ((topic, sample) for (topic, _), sample in found)
            waiting = [pair for pair, _ in found]
            if not waiting:
                return
            if self._clock.elapsed_ns() > until_ns:
                break
        self._news.ring()  # for what is left

    def _accepted(self, topic: Topic, sample: Sample) -> tuple[Sample, Input | Diagnostics] | None:
        """The sample and its message; None where it is not to be used."""
        if topic is DIAGNOSTICS and not self._doubts.wants(sample.payload):
            return None
        try:
            if not topic.may_be(sample.encoding):
                raise MessageError(f"its encoding is «{sample.encoding}», not «{topic.encoding}»")
            message = cdr.decode(topic.type_name, sample.payload)
        except MessageError as reason:
            self._node.health.reject(sample, reason)
            return None
        if isinstance(message, Diagnostics):
            return sample, message
        assert isinstance(message, Input)
        if message.stamp_ns == 0 and not isinstance(message, CameraInfo):
            message = stamped(message, sample.received_ns)
            sample = replace(sample, payload=cdr.encode(message))  # as it is to be stored
        at_ns, set_by_ns = self._clock.elapsed_ns(), self._node.clock_set_by_ns
        if not self._admission.takes(sample, message.stamp_ns, at_ns, set_by_ns=set_by_ns):
            return None
        self._diagnostics.heard(sample.key, at_ns)
        self._node.health.count(f"received {sample.key}")
        if isinstance(message, Sightings):
            self._node.health.count("faces", len(message.faces))
            self.delays.came(sample, message)
        return sample, message
