"""Garbage on the bus does not come in; what is dropped is counted by key."""

import threading
from collections import Counter
from collections.abc import Callable

import pytest
from support.builders import eventually, make_odometry, make_site

from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Sample
from trigpoint.contract import cdr
from trigpoint.contract.messages import Odometry, PoseStamped
from trigpoint.contract.topics import (
    CAMERA_POSE,
    IMAGE,
    ODOMETRY,
    SIGHTINGS,
    SUGGESTION,
    TF,
    TOPICS,
    Topic,
)
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.recorder.writing.intake import Intake, recorded_topics, sound_message
from trigpoint.testing.memory_bus import MemoryBroker, MemoryBus

SITE = make_site()
KEY = ODOMETRY.key("lab", "r1")
PAYLOAD = cdr.encode(make_odometry(5))


def sample(key: str = KEY, payload: bytes = PAYLOAD, encoding: str = ODOMETRY.encoding) -> Sample:
    return Sample(key, payload, encoding, 1, 2, sender="abc")


def test_a_sound_sample_is_decoded() -> None:
    message = sound_message(ODOMETRY, sample(), SITE)
    assert isinstance(message, Odometry)
    assert message.stamp_ns == 5


@pytest.mark.parametrize(
    ("bad", "complaint"),
    [
        (sample(payload=b"garbage"), "are no nav_msgs"),
        (sample(payload=b""), "are no nav_msgs"),
        (sample(encoding=SIGHTINGS.encoding), "the encoding is"),
        (sample(encoding="text/plain"), "the encoding is"),
        (sample(key="lab/robot/r9/odom"), "no robot «r9»"),
        (sample(key="lab/robot/r1/mood"), "no key of the contract|not a key of the contract"),
    ],
)
def test_what_the_contract_does_not_say_is_refused(bad: Sample, complaint: str) -> None:
    with pytest.raises(MessageError, match=complaint):
        sound_message(ODOMETRY, bad, SITE)


def test_an_unknown_camera_is_refused() -> None:
    with pytest.raises(MessageError, match="no camera «c9»"):
        sound_message(
            CAMERA_POSE, sample("lab/camera/c9/pose", encoding=CAMERA_POSE.encoding), SITE
        )


def test_pictures_are_recorded_only_where_they_are_wanted() -> None:
    wanting = make_site(more="[recorder]\npictures = true")
    assert set(TOPICS) - set(recorded_topics(SITE)) == {IMAGE}
    assert set(recorded_topics(wanting)) == set(TOPICS)


def test_garbage_is_counted_and_its_sender_named() -> None:
    broker, taken = MemoryBroker(), []
    with (
        broker.session() as bus,
        broker.session() as stranger,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        Intake(bus, node, SITE, [ODOMETRY, TF], lambda *received: taken.append(received))
        publisher = stranger.publisher(ODOMETRY, KEY)
        publisher.put(b"garbage")
        publisher.put(PAYLOAD)
        assert eventually(lambda: bool(taken) and node.health.total("rejected") == 1)
        assert f"session {stranger.identity}" in node.health.last_error
        assert KEY in node.health.last_error
        node.stop()
    assert [received[1].payload for received in taken] == [PAYLOAD]


def test_what_has_arrived_when_the_node_stops_is_handed_on() -> None:
    broker, taken = MemoryBroker(), []

    def take(_topic: Topic, received: Sample, _message: object) -> None:
        if not taken:
            node.stop()  # the rest is waiting now
        taken.append(received)

    with (
        broker.session() as bus,
        broker.session() as sender,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        publisher = sender.publisher(ODOMETRY, KEY)
        for _ in range(50):
            publisher.put(PAYLOAD)
        Intake(bus, node, SITE, [ODOMETRY], take)
    assert len(taken) == 50


class Way(MemoryBus):
    """A bus on which what was sent comes when it is waited for."""

    def __init__(self, broker: MemoryBroker, arrive: Callable[[], None]) -> None:
        super().__init__(broker, "1")
        self._arrive = arrive

    def catch_up(self, site: str, timeout_s: float) -> bool:
        assert (site, timeout_s > 0) == ("lab", True)
        self._arrive()
        return True


def test_what_is_on_its_way_when_the_node_stops_is_handed_on() -> None:
    broker, taken = MemoryBroker(), []

    def arrive() -> None:
        for _ in range(50):
            publisher.put(PAYLOAD)

    with (
        Way(broker, arrive) as bus,
        broker.session() as sender,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        publisher = sender.publisher(ODOMETRY, KEY)
        Intake(bus, node, SITE, [ODOMETRY], lambda *received: taken.append(received))
        node.stop()
    assert len(taken) == 50


def test_what_was_sent_before_a_session_ends_is_handed_on_first() -> None:
    broker, taken = MemoryBroker(), []

    def arrive() -> None:
        if not taken:  # once more when the node stops
            for _ in range(50):
                publisher.put(PAYLOAD)

    with (
        Way(broker, arrive) as bus,
        broker.session() as sender,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        publisher = sender.publisher(ODOMETRY, KEY)
        intake = Intake(bus, node, SITE, [ODOMETRY], lambda *received: taken.append(received))
        intake.settle()
        assert len(taken) == 50
        node.stop()


def test_what_the_buss_queue_drops_is_told_by_key() -> None:
    broker, taken, lost = MemoryBroker(), [], Counter()
    first, may_go_on = threading.Event(), threading.Event()

    def take(_topic: Topic, received: Sample, _message: object) -> None:
        taken.append(received)
        first.set()
        may_go_on.wait(60)

    def lose(key: str, count: int) -> None:
        lost[key] += count

    with (
        broker.session() as bus,
        broker.session() as sender,
        Node(bus, site="lab", kind="recorder", name="main") as node,
    ):
        Intake(bus, node, SITE, [SUGGESTION], take, lose)
        key = SUGGESTION.key("lab", "r1")
        publisher = sender.publisher(SUGGESTION, key)
        payload = cdr.encode(PoseStamped(5, "map", Pose.identity()))
        publisher.put(payload)
        assert first.wait(60)
        for _ in range(200):
            publisher.put(payload)
        may_go_on.set()
        assert eventually(lambda: len(taken) + lost[key] == 201)
        node.stop()
    assert lost[key] == 200 - 64  # the recorder's queue is deeper than the topic's own
