"""What every part sees of the bus; `bus_zenoh` and `bus_memory` implement it.

Nothing runs on the bus's own threads but putting a sample into a bounded queue of ours: whoever
subscribes takes samples out on a thread of its own. Closing the bus closes what it declared.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from .topics import Topic

COMMAND_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class Sample:
    """One payload that arrived.

    `published_ns`: the sender's Zenoh timestamp as Unix time; `received_ns`: when it came here;
    `sender`: the Zenoh id of the publishing session, "" where it is not known.
    """

    key: str
    payload: bytes
    encoding: str
    published_ns: int
    received_ns: int
    attachment: bytes = b""
    sender: str = ""


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer to a query; `error` is one line where the other side refused, else ""."""

    key: str
    payload: bytes
    error: str = ""


class Bell:
    """Wakes a thread that waits for anything to come. Any thread may ring it, once or more often.

    A bare lock, held while nothing has come: a Condition wakes its waiter under a lock that the
    waker still holds, which takes twice as long (49 against 23 µs).
    """

    def __init__(self) -> None:
        self._is_silent = threading.Lock()
        self._is_silent.acquire()

    def ring(self) -> None:
        if self._is_silent.locked():
            with suppress(RuntimeError):  # another was quicker
                self._is_silent.release()

    def wait(self, timeout_s: float) -> bool:
        """Until it is rung, or has been since the last wait; false where the time is over."""
        return self._is_silent.acquire(timeout=max(0.0, timeout_s))


class Subscription(Protocol):
    """Samples of one key expression, in the order in which they came."""

    def take(self, timeout_s: float) -> Sample | None:
        """The next sample, or None when the time is over or the subscription is closed."""
        ...

    @property
    def depth(self) -> int:
        """How many samples wait."""
        ...

    @property
    def received(self) -> int:
        """How many samples came."""
        ...

    @property
    def dropped(self) -> int:
        """How many samples were lost: dropped from the full queue, or missed on the way."""
        ...

    @property
    def losses(self) -> dict[str, int]:
        """Those that were dropped from the full queue, by key."""
        ...

    def close(self) -> None: ...


class Publisher(Protocol):
    """Sends on one key."""

    def put(self, payload: bytes, *, attachment: bytes = b"") -> None:
        """Hand it over to be sent; never waits for anybody, so that a thread which reads a port or
        a camera may call it."""
        ...

    @property
    def has_listener(self) -> bool:
        """Whether anyone subscribes to the key now (pictures are only made where it is so)."""
        ...

    def close(self) -> None: ...


class Closable(Protocol):
    """A declaration that can be taken back."""

    def close(self) -> None: ...


class Bus(Protocol):
    """An open session."""

    @property
    def identity(self) -> str:
        """The session's Zenoh id, as samples name it in `sender`."""
        ...

    @property
    def locators(self) -> tuple[str, ...]:
        """Where this session listens, as others may write it into `bus.connect`."""
        ...

    @property
    def peers(self) -> tuple[str, ...]:
        """The ids of the sessions that this one is connected to."""
        ...

    @property
    def warning(self) -> str:
        """What will end the connection before long (a certificate's end), "" where nothing will."""
        ...

    @property
    def unreached(self) -> tuple[str, ...]:
        """What `bus.connect` names, while the session is connected to nobody."""
        ...

    @property
    def unsent(self) -> int:
        """How many samples were not sent, since nobody took those before them in time."""
        ...

    def flush(self, timeout_s: float) -> bool:
        """Wait until all that was put is sent; whether it is in time."""
        ...

    def catch_up(self, site: str, timeout_s: float) -> bool:
        """Wait until what the others of a site have sent before has come, as far as every sample of
        it must arrive; whether all of them answered in time."""
        ...

    def publisher(self, topic: Topic, key: str) -> Publisher:
        """Declare a publisher with the topic's delivery."""
        ...

    def subscribe(
        self,
        topic: Topic,
        expression: str,
        *,
        wanted: Callable[[str], bool] | None = None,
        in_turns: bool = False,
        bell: Bell | None = None,
    ) -> Subscription:
        """Subscribe with the topic's delivery and queue. `wanted`: whether a key is; the others'
        samples are not kept. It is called on the bus's thread. `in_turns`: keys and senders take
        turns; else samples are taken in the order in which they came. `bell`: rung when one
        comes."""
        ...

    def declare_alive(self, key: str) -> Closable:
        """Declare a liveliness token."""
        ...

    def alive(self, expression: str, *, timeout_s: float = COMMAND_TIMEOUT_S) -> list[str]:
        """The tokens that are alive now; without those whose sessions do not answer in time."""
        ...

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> Closable:
        """Answer queries on `key` on a thread of ours.

        `answer` gets the request's payload and returns the reply's; a TrigpointError that it raises
        becomes an error reply with its text, any other error one that says so.
        """
        ...

    def query(
        self, key: str, payload: bytes = b"", *, timeout_s: float = COMMAND_TIMEOUT_S
    ) -> list[Reply]:
        """Ask everyone who serves `key`; an empty list where nobody answered in time."""
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...
