"""What the demo itself hears on the bus: who is up, how far the network is, who counted what."""

from collections.abc import Collection
from contextlib import suppress

from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bus, Subscription
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import DiagnosticStatus, PoseEstimate
from trigpoint.contract.topics import (
    CAMERA_POSE,
    DIAGNOSTICS,
    ROBOT_POSE,
    Topic,
    alive_key,
    command_key,
    node_of,
    topic_of,
)
from trigpoint.geometry.uncertainty import position_sigma
from trigpoint.tools.site.status import statuses_in

_TOTAL = ".total"
_LOST = ".lost"
_TURN_S = 10.0


class Watch:
    """Reads the bus when it is told to; used by one thread."""

    def __init__(self, bus: Bus, site: str) -> None:
        self._bus, self._site = bus, site
        self._subscriptions = [
            (topic, bus.subscribe(topic, topic.expression(site)))
            for topic in (DIAGNOSTICS, CAMERA_POSE, ROBOT_POSE)
        ]
        self._statuses: dict[tuple[str, str], DiagnosticStatus] = {}
        self.cameras: dict[str, float] = {}
        """Located camera -> sigma of its place, metres."""
        self.robots: dict[str, float] = {}
        """Robot -> sigma of its place, metres."""

    def close(self) -> None:
        for _, subscription in self._subscriptions:
            subscription.close()

    def missing(self, tokens: Collection[str]) -> set[str]:
        return set(tokens) - set(self._bus.alive(alive_key(self._site, "*", "*")))

    def read(self) -> None:
        for topic, subscription in self._subscriptions:
            if topic is DIAGNOSTICS:
                self._read_diagnostics(subscription)
            else:
                self._read_poses(topic, subscription)

    def _read_diagnostics(self, subscription: Subscription) -> None:
        while (sample := subscription.take(0.0)) is not None:
            for status in statuses_in(sample):
                self._statuses[status.name, status.values.get("node", "")] = status

    def _read_poses(self, topic: Topic, subscription: Subscription) -> None:
        """Only the newest of each camera or robot is decoded."""
        newest: dict[str, bytes] = {}
        while (sample := subscription.take(0.0)) is not None:
            newest[node_of(sample.key)] = sample.payload
        known = self.cameras if topic is CAMERA_POSE else self.robots
        for name, payload in newest.items():
            with suppress(MessageError):  # which the nodes themselves report
                message = decode(topic.type_name, payload)
                assert isinstance(message, PoseEstimate)
                known[name] = position_sigma(message.covariance)

    def counts(self) -> dict[str, dict[str, int]]:
        """Node -> name -> total, and `name.lost` -> losses, as they were last heard; a node that
        was started again has the sum over its lives."""
        counts: dict[str, dict[str, int]] = {}
        for (name, _), status in self._statuses.items():
            node = counts.setdefault(name, {})
            for key, text in status.values.items():
                if key.endswith((_TOTAL, _LOST)) and text.isdecimal():
                    short = key.removesuffix(_TOTAL)
                    node[short] = node.get(short, 0) + int(text)
        return counts

    def is_settled(self, kind: str) -> bool:
        """Whether all that the nodes of a kind sent on reliable keys was received, as far as both
        sides have said."""
        counts = self.counts()
        received = totals(counts, "received")
        return all(
            list(received.get(key, {}).values()) == [number]
            for key, senders in totals(counts, "sent").items()
            for node, number in senders.items()
            if node.startswith(f"{kind}/") and _is_reliable(key)
        )

    def wait_for_fusion(self) -> None:
        """Return when fusion has worked on all that it has received: it answers between its turns.
        At once where it is not there."""
        self._bus.query(command_key(self._site, "fusion/map"), timeout_s=_TURN_S)

    def total(self, word: str) -> int:
        """A counter's sum over all nodes."""
        return sum(node.get(word, 0) for node in self.counts().values())


def totals(counts: dict[str, dict[str, int]], verb: str) -> dict[str, dict[str, int]]:
    """Key -> node -> number, of the counters that are named «verb key»."""
    found: dict[str, dict[str, int]] = {}
    for node, numbers in counts.items():
        for name, number in numbers.items():
            word, _, key = name.partition(" ")
            if word == verb and topic_of(key) is not None:
                found.setdefault(key, {})[node] = number
    return found


def _is_reliable(key: str) -> bool:
    topic = topic_of(key)
    return topic is not None and topic.delivery.is_reliable
