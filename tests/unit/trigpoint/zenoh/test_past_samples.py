"""Samples are handed on from their sender's first, whenever a subscriber meets them."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
import zenoh
from support.builders import eventually
from zenoh import ext

from trigpoint.zenoh.past_samples import History
from trigpoint.zenoh.session import called_at_once

KEY = "lab/robot/r1/odom"
KEPT = 64


def session(**endpoints: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    for kind, endpoint in endpoints.items():
        config.insert_json5(f"{kind}/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


@pytest.fixture(name="sessions")
def _sessions(free_port: Callable[[], int]) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    address = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        yield (
            stack.enter_context(session(listen=address)),
            stack.enter_context(session(connect=address)),
        )


def sender(session: zenoh.Session) -> ext.AdvancedPublisher:
    detection = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5)
    return ext.declare_advanced_publisher(
        session, KEY, cache=ext.CacheConfig(KEPT), sample_miss_detection=detection
    )


def listen(session: zenoh.Session) -> list[str]:
    """What a History hands on that a plain subscriber feeds, which never asks for anything."""
    came: list[str] = []
    history = History(session, KEPT, lambda sample: came.append(sample.payload.to_string()))
    session.declare_subscriber(KEY, called_at_once(history.receive))
    return came


@pytest.mark.parametrize("before", [0, 1, KEPT])
def test_what_was_sent_before_comes_first(
    sessions: tuple[zenoh.Session, zenoh.Session], before: int
) -> None:
    publisher = sender(sessions[0])
    for number in range(before):
        publisher.put(str(number))
    came = listen(sessions[1])
    assert eventually(lambda: meets(sessions[0]))
    for number in range(before, before + 10):
        publisher.put(str(number))
    # Of as many as are kept, each that comes before the question is answered pushes one out.
    assert eventually(lambda: came[-1:] == [str(before + 9)])
    numbers = [int(text) for text in came]
    assert numbers == list(range(numbers[0], before + 10))
    assert numbers[0] <= max(0, before + 10 - KEPT)


def test_senders_are_told_apart(sessions: tuple[zenoh.Session, zenoh.Session]) -> None:
    publishers = [sender(sessions[0]) for _ in range(3)]
    for number in range(20):
        for name, publisher in zip("abc", publishers, strict=True):
            publisher.put(f"{name}{number:02}")
    came = listen(sessions[1])
    assert eventually(lambda: meets(sessions[0]))
    for name, publisher in zip("abc", publishers, strict=True):
        publisher.put(f"{name}20")
    assert eventually(lambda: len(came) == 63)
    for name in "abc":
        assert [text for text in came if text[0] == name] == [f"{name}{n:02}" for n in range(21)]


def test_sample_without_a_number_is_handed_on(
    sessions: tuple[zenoh.Session, zenoh.Session],
) -> None:
    came = listen(sessions[1])
    assert eventually(lambda: meets(sessions[0]))
    sessions[0].put(KEY, "plain")
    assert eventually(lambda: came == ["plain"])


def meets(session: zenoh.Session) -> bool:
    """Whether somebody listens."""
    publisher = session.declare_publisher(KEY)
    status = publisher.matching_status
    publisher.undeclare()
    return bool(getattr(status, "matching", status))
