"""Samples are handed on from their sender's first and without gaps, whenever a subscriber meets
them; what never comes is counted."""

import json
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from types import SimpleNamespace

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


class Listener:
    """What a History hands on that a plain subscriber feeds, which never asks for anything, with
    samples `lost` on the way; the History's first `unheard` questions reach nobody, the answers to
    the next `broken` ones have their first sample alone, and those to the next `holed` ones their
    last."""

    def __init__(
        self,
        session: zenoh.Session,
        *,
        lost: Collection[str] = (),
        unheard: int = 0,
        broken: int = 0,
        holed: int = 0,
    ) -> None:
        self.came: list[str] = []
        self.missed = 0
        self.heard_on: set[int] = set()
        self.asked_on: set[int] = set()
        self._session, self._lost = session, lost
        self._turns = ["unheard"] * unheard + ["broken"] * broken + ["holed"] * holed
        self.history = History(
            self,  # pyright: ignore[reportArgumentType]
            KEPT,
            lambda sample: self.came.append(sample.payload.to_string()),
            self._miss,
        )
        session.declare_subscriber(KEY, called_at_once(self._receive))

    def get(self, selector: str, *words: object, **options: object) -> None:
        """Stands for the session's."""
        self.asked_on.add(threading.get_ident())
        if (turn := self._turns.pop(0) if self._turns else "") == "unheard":
            selector = "nobody/here"
        elif turn == "broken":
            begin = selector.partition("_sn=")[2].partition("..")[0]
            selector = f"{selector.partition('..')[0]}..{begin}"
        elif turn == "holed":
            begin, _, end = selector.partition("_sn=")[2].partition("..")
            selector = selector.replace(f"{begin}..{end}", f"{end}..{end}")
        self._session.get(selector, *words, **options)  # pyright: ignore

    def _receive(self, sample: zenoh.Sample) -> None:
        self.heard_on.add(threading.get_ident())
        if sample.payload.to_string() not in self._lost:
            self.history.receive(sample)

    def _miss(self, count: int) -> None:
        self.missed += count


def listen(session: zenoh.Session) -> list[str]:
    """What a History hands on."""
    return Listener(session).came


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


@pytest.mark.parametrize(
    ("unheard", "broken", "holed"),
    [(0, 0, 0), (2, 0, 0), (0, 2, 0), (1, 1, 0), (0, 0, 1), (1, 1, 1)],
)
def test_what_is_lost_in_between_is_asked_for_until_its_sender_answers(
    sessions: tuple[zenoh.Session, zenoh.Session], unheard: int, broken: int, holed: int
) -> None:
    publisher = sender(sessions[0])
    listener = Listener(sessions[1], lost=("3", "4"), unheard=unheard, broken=broken, holed=holed)
    assert eventually(lambda: meets(sessions[0]))
    for number in range(10):
        publisher.put(str(number))
    assert eventually(lambda: listener.came[-1:] == ["9"])
    assert listener.came == [str(number) for number in range(10)]
    assert listener.missed == 0


def test_nothing_is_asked_on_the_thread_that_hands_samples_on(
    sessions: tuple[zenoh.Session, zenoh.Session],
) -> None:
    """Where a link closes, it holds the lock of Zenoh's tables, for which a question waits."""
    publisher = sender(sessions[0])
    listener = Listener(sessions[1], lost=("3", "4"))
    assert eventually(lambda: meets(sessions[0]))
    for number in range(10):
        publisher.put(str(number))
    assert eventually(lambda: listener.came[-1:] == ["9"])
    assert listener.asked_on
    assert not listener.asked_on & listener.heard_on


class Closed:
    """A closed session: it ends what is asked of it, and raises as well."""

    asked = 0

    def get(self, selector: str, handler: "zenoh.handlers.Callback[object]", **_: object) -> None:
        self.asked += 1
        if handler.drop is not None:
            handler.drop()
        raise zenoh.ZError("the session is closed")


def test_of_a_closed_session_one_question_is_asked_at_a_time() -> None:
    session = Closed()
    history = History(session, KEPT, print, print)  # pyright: ignore
    identity = SimpleNamespace(zid="ab", eid=1)
    about = SimpleNamespace(source_id=identity, source_sn=5)
    history.receive(SimpleNamespace(key_expr=KEY, source_info=about))  # pyright: ignore

    def waiting() -> int:
        timers = [each for each in threading.enumerate() if isinstance(each, threading.Timer)]
        return sum(getattr(timer.function, "__self__", None) is history for timer in timers)

    assert eventually(lambda: session.asked > 3)
    assert waiting() <= 2  # the next one, and that which asks now
    history.close()
    assert eventually(lambda: waiting() == 0)


def test_what_is_missing_from_every_answer_is_counted_in_the_end(
    sessions: tuple[zenoh.Session, zenoh.Session],
) -> None:
    publisher = sender(sessions[0])
    listener = Listener(sessions[1], lost=("3", "4"), holed=1000)
    assert eventually(lambda: meets(sessions[0]))
    for number in range(10):
        publisher.put(str(number))
    assert eventually(lambda: listener.came[-1:] == ["9"])
    assert listener.came == [str(number) for number in range(10) if number not in (3, 4)]
    assert listener.missed == 2


def test_what_its_sender_no_longer_keeps_is_counted(
    sessions: tuple[zenoh.Session, zenoh.Session],
) -> None:
    publisher = sender(sessions[0])
    lost = {str(number) for number in range(5, 105)}
    listener = Listener(sessions[1], lost=lost)
    assert eventually(lambda: meets(sessions[0]))
    for number in range(106):
        publisher.put(str(number))
    assert eventually(lambda: listener.came[-1:] == ["105"])
    assert len(listener.came) + listener.missed == 106
    assert 106 - KEPT - 5 <= listener.missed <= 106 - KEPT


def test_what_made_room_before_a_new_sender_answers_is_not_lost(
    sessions: tuple[zenoh.Session, zenoh.Session],
) -> None:
    """The first sample to come is one of those on their way while somebody comes."""
    publisher = sender(sessions[0])
    first = str(KEPT - 1)
    listener = Listener(sessions[1], lost={str(n) for n in range(KEPT + 2)} - {first}, unheard=1)
    assert eventually(lambda: meets(sessions[0]))
    for number in range(KEPT + 2):
        publisher.put(str(number))
    assert eventually(lambda: listener.came[-1:] == [first])
    assert listener.came == [str(number) for number in range(2, KEPT)]
    assert listener.missed == 0


@pytest.mark.parametrize("first", [0, 1])
def test_what_nobody_answers_for_is_counted(
    sessions: tuple[zenoh.Session, zenoh.Session], first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.zenoh.past_samples._PATIENCE_S", 0.5)
    publisher = sender(sessions[0])
    lost = [str(number) for number in range(first, 4)]
    listener = Listener(sessions[1], lost=lost, unheard=1000)
    assert eventually(lambda: meets(sessions[0]))
    for number in range(6):
        publisher.put(str(number))
    assert eventually(lambda: listener.came[-1:] == ["5"])
    assert listener.missed == len(lost)


def test_closed_one_asks_no_more(
    sessions: tuple[zenoh.Session, zenoh.Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.zenoh.past_samples._AGAIN_S", 3600.0)
    publisher = sender(sessions[0])
    listener = Listener(sessions[1], lost=("1",), unheard=1000)
    assert eventually(lambda: meets(sessions[0]))
    for number in range(3):
        publisher.put(str(number))
    timers = lambda: [t for t in threading.enumerate() if isinstance(t, threading.Timer)]  # noqa: E731
    assert eventually(lambda: bool(timers()))
    listener.history.close()
    assert eventually(lambda: not timers())


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
