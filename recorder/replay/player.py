"""Puts a recorded session back on the bus: the same bytes, at the recorded pace."""

import threading
from collections.abc import Collection, Iterator

from msgspec import Struct

from trigpoint.base.clock import Clock
from trigpoint.base.errors import InputError, OperationError
from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract.topics import (
    CAMERA_INFO,
    CORRECTION,
    DIAGNOSTICS,
    IMAGE,
    ODOMETRY,
    SIGHTINGS,
    Topic,
    alive_key,
    key_matches,
    node_of,
    topic_of,
)
from trigpoint.recorder.session.recording import RecordedSample, Recording

from .pace import WHOLE, Controls, Pace, Span

_DISCOVERY_S = 0.5
"""Subscribers need a moment to be known to a new publisher; what is put before is lost to them."""


class Route(Struct, frozen=True):
    """One key of the recording, and the key on the bus that its messages go to."""

    key: str
    topic: Topic
    sent_as: str


class Plan(Struct, frozen=True):
    """What is replayed; `left_out`: key -> why it is not."""

    routes: tuple[Route, ...]
    left_out: dict[str, str]


def plan(recording: Recording, bus: Bus, *, site: str, keys: str) -> Plan:
    """Choose the keys that match `keys` (with or without the site) and that nobody alive sends.

    Diagnostics are never replayed: they would speak for nodes that do not run. Raises InputError
    where no key matches, OperationError where every matching one has a living sender.
    """
    recording.check_is_session()
    matching = {
        key: topic for key in recording.counts if (topic := topic_of(key)) and _is_wanted(keys, key)
    }
    if not matching:
        known = ", ".join(recording.counts)
        raise InputError(f"{recording.path}: no key matches «{keys}»; it has {known}")
    alive = bus.alive(f"{site}/alive/**")
    obstacles = {
        key: _obstacle(topic, node_of(key), site, alive) for key, topic in matching.items()
    }
    left_out = {key: reason for key, reason in obstacles.items() if reason}
    routes = tuple(
        Route(key, topic, f"{site}/{key.partition('/')[2]}")
        for key, topic in matching.items()
        if key not in left_out
    )
    if not routes:
        reasons = "; ".join(sorted(set(left_out.values())))
        raise OperationError(f"nothing to replay on site {site}: {reasons}")
    return Plan(routes, left_out)


def replay(
    recording: Recording,
    bus: Bus,
    routes: Collection[Route],
    *,
    rate: float,
    clock: Clock,
    stopping: threading.Event,
    span: Span = WHOLE,
    controls: Controls | None = None,
) -> dict[str, int]:
    """Put the messages, log time by log time divided by `rate`; return how many each key got.

    Blocks until the end or until `stopping` is set. Bytes, attachments and header stamps stay as
    they were recorded. A reliable topic waits for a slow receiver; what was missed of the pace is
    caught up.
    """
    publishers = {route.key: bus.publisher(route.topic, route.sent_as) for route in routes}
    counts = dict.fromkeys(publishers, 0)
    topics = {route.topic for route in routes}
    try:
        clock.wait(stopping, _DISCOVERY_S)
        while True:
            pace = Pace(rate, clock, stopping, controls or Controls())
            samples = recording.samples(topics, from_ns=span.from_ns, to_ns=span.to_ns)
            _put_all(samples, publishers, pace, counts)
            if not span.loops or stopping.is_set():
                return counts
    finally:
        for publisher in publishers.values():
            publisher.close()


def _put_all(
    samples: Iterator[RecordedSample],
    publishers: dict[str, Publisher],
    pace: Pace,
    counts: dict[str, int],
) -> None:
    for sample in samples:
        if publisher := publishers.get(sample.key):
            if not pace.is_due(sample.log_ns):
                break
            publisher.put(sample.payload, attachment=sample.attachment)
            counts[sample.key] += 1


def _is_wanted(expression: str, key: str) -> bool:
    return key_matches(expression, key) or key_matches(expression, key.partition("/")[2])


def _obstacle(topic: Topic, node: str, site: str, alive: Collection[str]) -> str:
    """Why a key may not be replayed now, "" where it may."""
    if topic is DIAGNOSTICS:
        return "diagnostics are not replayed"
    senders = [_sender(topic, node, site)]
    if topic is CORRECTION:
        senders.append(alive_key(site, "robot", node))  # it would drive by an old correction
    for token in alive:
        if any(key_matches(sender, token) for sender in senders):
            return f"{token.partition('/alive/')[2]} runs there; stop it or choose another --site"
    return ""


def _sender(topic: Topic, node: str, site: str) -> str:
    """The liveliness token of whoever sends a topic."""
    if topic in (IMAGE, CAMERA_INFO, SIGHTINGS):
        return alive_key(site, "edge", node)
    if topic is ODOMETRY:
        return alive_key(site, "robot", node)
    return alive_key(site, "fusion", "*")
