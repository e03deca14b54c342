"""What both buses promise."""

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from support.builders import eventually, make_site

from trigpoint.base.errors import BusError, InputError
from trigpoint.bus.bus import Bus, Sample, Subscription
from trigpoint.bus.settings import Settings
from trigpoint.contract.topics import (
    CAMERA_INFO,
    CORRECTION,
    DIAGNOSTICS,
    IMAGE,
    ODOMETRY,
    SIGHTINGS,
    TF,
    Topic,
    alive_key,
)
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.zenoh import ZenohBus, open_bus, open_session
from trigpoint.zenoh.patience import open_patiently

ODOM_KEY = ODOMETRY.key("lab", "r1")

Session = Callable[[], Bus]


@pytest.fixture(params=["memory", "zenoh"])
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    """Opens sessions that see each other; all are closed at the end."""
    with ExitStack() as stack:
        if request.param == "memory":
            broker = MemoryBroker()
            yield lambda: stack.enter_context(broker.session())
        else:
            meeting = stack.enter_context(open_bus(make_site(bus='listen = ["tcp/127.0.0.1:0"]')))
            settings = Settings("client", connect=meeting.locators)  # opens faster than a peer

            def opened() -> Bus:
                session = open_patiently(lambda: open_session(settings), settings, 60.0)
                return stack.enter_context(ZenohBus(session))

            yield opened


@pytest.fixture
def pair(session: Session) -> tuple[Bus, Bus]:
    return session(), session()


def take(subscription: Subscription, count: int) -> list[Sample]:
    samples = [subscription.take(60.0) for _ in range(count)]
    return [sample for sample in samples if sample is not None]


def payloads(samples: list[Sample]) -> list[bytes]:
    return [sample.payload for sample in samples]


@pytest.mark.parametrize("topic", [IMAGE, CAMERA_INFO, SIGHTINGS, CORRECTION, TF, DIAGNOSTICS])
def test_sample_arrives_with_all_that_was_sent(pair: tuple[Bus, Bus], topic: Topic) -> None:
    sender, receiver = pair
    key = topic.key("lab", "n1")
    subscription = receiver.subscribe(topic, topic.expression("lab"))
    publisher = sender.publisher(topic, key)
    assert eventually(lambda: publisher.has_listener)
    publisher.put(b"payload", attachment=b"attached")
    [sample] = take(subscription, 1)
    assert (sample.key, sample.payload, sample.attachment) == (key, b"payload", b"attached")
    assert sample.encoding == f"application/cdr;{topic.type_name}"
    assert sample.sender == sender.identity
    assert abs(sample.received_ns - sample.published_ns) < 10_000_000_000


def test_samples_of_one_sender_arrive_in_order(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    subscription = receiver.subscribe(ODOMETRY, ODOMETRY.expression("lab"))
    publisher = sender.publisher(ODOMETRY, ODOM_KEY)
    expected = [str(number).encode() for number in range(500)]
    for payload in expected:
        publisher.put(payload)
    assert payloads(take(subscription, 500)) == expected
    assert (subscription.received, subscription.dropped) == (500, 0)


def test_who_catches_up_has_what_was_sent_before(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    subscription = receiver.subscribe(ODOMETRY, ODOMETRY.expression("lab"))
    publisher = sender.publisher(ODOMETRY, ODOM_KEY)
    publisher.put(b"first")
    assert payloads(take(subscription, 1)) == [b"first"]
    for count in range(1, 6):
        for _ in range(500):
            publisher.put(b"more")
        publisher.close() if count == 5 else None
        assert receiver.catch_up("lab", 10.0)
        assert subscription.received == 1 + 500 * count


def test_own_samples_arrive_too(session: Session) -> None:
    bus = session()
    subscription = bus.subscribe(TF, TF.key("lab"))
    bus.publisher(TF, TF.key("lab")).put(b"own")
    assert payloads(take(subscription, 1)) == [b"own"]


def test_late_joiner_gets_the_last_value_once(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    early = receiver.subscribe(CAMERA_INFO, CAMERA_INFO.expression("lab"))
    publisher = sender.publisher(CAMERA_INFO, CAMERA_INFO.key("lab", "c1"))
    assert eventually(lambda: publisher.has_listener)
    publisher.put(b"old")
    publisher.put(b"new")
    assert payloads(take(early, 2)) == [b"old", b"new"]
    subscription = receiver.subscribe(CAMERA_INFO, CAMERA_INFO.expression("lab"))
    assert payloads(take(subscription, 1)) == [b"new"]
    publisher.put(b"newer")
    assert payloads(take(subscription, 1)) == [b"newer"]
    assert subscription.take(0.1) is None


def test_the_newest_of_each_key_is_had_also_by_late_joiners(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    publishers = [sender.publisher(CAMERA_INFO, CAMERA_INFO.key("lab", f"c{n}")) for n in (1, 2)]
    for publisher in publishers:
        publisher.put(b"old")
        publisher.put(b"new")
    assert sender.flush(10.0)
    latest = receiver.latest(CAMERA_INFO, CAMERA_INFO.expression("lab"))
    assert eventually(lambda: latest.depth == 2)
    taken = latest.take()
    assert sorted(sample.key for sample in taken) == [
        "lab/camera/c1/camera_info",
        "lab/camera/c2/camera_info",
    ]
    assert payloads(taken) == [b"new", b"new"]
    publishers[0].put(b"newer")
    publishers[0].put(b"newest")
    assert eventually(lambda: latest.received == 4)
    assert payloads(latest.take()) == [b"newest"]
    latest.close()
    publishers[0].put(b"unheard")
    assert sender.flush(10.0)
    assert latest.take() == []


def test_late_joiner_gets_what_it_missed_as_far_as_the_cache_reaches(
    pair: tuple[Bus, Bus],
) -> None:
    sender, receiver = pair
    publisher = sender.publisher(ODOMETRY, ODOM_KEY)
    for number in range(ODOMETRY.cache + 10):
        publisher.put(str(number).encode())
    assert sender.flush(10.0)
    subscription = receiver.subscribe(ODOMETRY, ODOMETRY.expression("lab"))
    expected = [str(number).encode() for number in range(10, ODOMETRY.cache + 10)]
    assert payloads(take(subscription, ODOMETRY.cache)) == expected
    publisher.put(b"live")
    assert payloads(take(subscription, 1)) == [b"live"]
    assert subscription.dropped == 0


def test_late_joiner_gets_nothing_old_of_a_key_without_cache(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    early = receiver.subscribe(TF, TF.key("lab"))
    publisher = sender.publisher(TF, TF.key("lab"))
    assert eventually(lambda: publisher.has_listener)
    publisher.put(b"old")
    assert payloads(take(early, 1)) == [b"old"]
    subscription = receiver.subscribe(TF, TF.key("lab"))
    assert eventually(lambda: publisher.has_listener)
    publisher.put(b"new")
    assert payloads(take(subscription, 1)) == [b"new"]


def test_late_publisher_reaches_an_early_subscriber(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    subscription = receiver.subscribe(CAMERA_INFO, CAMERA_INFO.expression("lab"))
    sender.publisher(CAMERA_INFO, CAMERA_INFO.key("lab", "c1")).put(b"at once")
    assert payloads(take(subscription, 1)) == [b"at once"]


def test_full_queue_drops_the_oldest_and_counts_it(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    subscription = receiver.subscribe(CORRECTION, CORRECTION.expression("lab"))
    key = CORRECTION.key("lab", "r1")
    publisher = sender.publisher(CORRECTION, key)
    assert eventually(lambda: publisher.has_listener)
    sent = CORRECTION.queue + 5
    for number in range(sent):
        publisher.put(str(number).encode())
    assert eventually(lambda: subscription.received == sent)
    assert (subscription.depth, subscription.dropped) == (CORRECTION.queue, 5)
    expected = [str(number).encode() for number in range(5, sent)]
    assert payloads(take(subscription, CORRECTION.queue)) == expected


def test_taking_ends_when_the_time_is_over(session: Session) -> None:
    assert session().subscribe(TF, TF.key("lab")).take(0.01) is None


def test_closing_a_subscription_wakes_whoever_waits(session: Session) -> None:
    subscription = session().subscribe(TF, TF.key("lab"))
    results: list[Sample | None] = []
    waiting = threading.Thread(target=lambda: results.append(subscription.take(60.0)))
    waiting.start()
    subscription.close()
    waiting.join(10.0)
    assert results == [None]


def test_a_listener_is_seen_come_and_go(pair: tuple[Bus, Bus]) -> None:
    sender, receiver = pair
    publisher = sender.publisher(IMAGE, IMAGE.key("lab", "c1"))
    assert not publisher.has_listener
    subscription = receiver.subscribe(IMAGE, IMAGE.expression("lab"))
    assert eventually(lambda: publisher.has_listener)
    subscription.close()
    assert eventually(lambda: not publisher.has_listener)


def test_a_closed_publisher_refuses_to_send(session: Session) -> None:
    publisher = session().publisher(ODOMETRY, ODOM_KEY)
    publisher.close()
    publisher.close()
    with pytest.raises(BusError, match=ODOM_KEY):
        publisher.put(b"late")


def test_tokens_appear_and_disappear(pair: tuple[Bus, Bus]) -> None:
    one, other = pair
    key = alive_key("lab", "edge", "c1")
    token = one.declare_alive(key)
    assert eventually(lambda: other.alive("lab/alive/**") == [key])
    assert one.alive(alive_key("lab", "edge", "*")) == [key]
    assert other.alive("hall/alive/**") == []
    token.close()
    token.close()
    assert eventually(lambda: other.alive("lab/alive/**") == [])


def test_a_closed_session_takes_its_declarations_along(pair: tuple[Bus, Bus]) -> None:
    one, other = pair
    one.declare_alive("lab/alive/edge/c1")
    one.serve("lab/clock", lambda payload: payload)
    one.subscribe(IMAGE, IMAGE.expression("lab"))
    publisher = other.publisher(IMAGE, IMAGE.key("lab", "c1"))
    assert eventually(lambda: publisher.has_listener and other.alive("lab/**") != [])
    one.close()
    assert eventually(lambda: not publisher.has_listener and other.alive("lab/**") == [])
    assert other.query("lab/clock", timeout_s=1.0) == []


def test_query_gets_the_answer_of_everyone_who_serves_the_key(session: Session) -> None:
    one, two, three = session(), session(), session()
    one.serve("lab/camera/c1/snapshot", lambda payload: b"one " + payload)
    two.serve("lab/camera/c2/snapshot", lambda payload: b"two " + payload)
    assert eventually(lambda: len(three.query("lab/camera/*/snapshot")) == 2)
    replies = three.query("lab/camera/*/snapshot", b"please")
    assert {reply.key: reply.payload for reply in replies} == {
        "lab/camera/c1/snapshot": b"one please",
        "lab/camera/c2/snapshot": b"two please",
    }


def test_refusal_arrives_as_one_line(pair: tuple[Bus, Bus]) -> None:
    one, other = pair

    def refuse(payload: bytes) -> bytes:
        raise InputError("there is no map yet; drive past a camera first")

    one.serve("lab/fusion/map", refuse)
    assert eventually(lambda: other.query("lab/fusion/map") != [])
    [reply] = other.query("lab/fusion/map")
    assert (reply.error, reply.payload) == ("there is no map yet; drive past a camera first", b"")


def test_broken_service_says_so_and_goes_on(
    pair: tuple[Bus, Bus], caplog: pytest.LogCaptureFixture
) -> None:
    one, other = pair

    def divide(payload: bytes) -> bytes:
        return str(1 / int(payload)).encode()

    one.serve("lab/divide", divide)
    assert eventually(lambda: other.query("lab/divide", b"1") != [])
    [broken] = other.query("lab/divide", b"0")
    assert "ZeroDivisionError" in broken.error
    assert [reply.payload for reply in other.query("lab/divide", b"1")] == [b"1.0"]
    assert "lab/divide" in caplog.text


def test_nobody_to_ask_is_an_empty_answer(session: Session) -> None:
    assert session().query("lab/nobody", timeout_s=1.0) == []


def test_an_answer_that_takes_too_long_is_left_out(pair: tuple[Bus, Bus]) -> None:
    one, other = pair
    release = threading.Event()

    def answer(payload: bytes) -> bytes:
        if payload == b"slow":
            release.wait(60.0)
        return b"done"

    one.serve("lab/slow", answer)
    assert eventually(lambda: other.query("lab/slow", b"fast") != [])
    assert other.query("lab/slow", b"slow", timeout_s=0.2) == []
    release.set()
    assert eventually(lambda: other.query("lab/slow", b"fast") != [])


def test_answers_are_made_on_a_thread_of_ours(session: Session) -> None:
    bus = session()
    names: list[str] = []

    def answer(payload: bytes) -> bytes:
        names.append(threading.current_thread().name)
        return b""

    service = bus.serve("lab/clock", answer)
    bus.query("lab/clock")
    service.close()
    assert names == ["serve lab/clock"]
