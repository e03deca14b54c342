"""The bus interface that every part uses; `trigpoint.zenoh` and `testing.memory_bus` implement it.

The bus's own threads only put samples into our bounded queues; subscribers take them out on their
own threads. Closing the bus closes everything declared on it.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Protocol, Self

from msgspec import Struct

from trigpoint.contract.topics import Topic

COMMAND_TIMEOUT_S = 5.0


class Sample(Struct, frozen=True):
    """One received payload.

    `published_ns`: the sender's Zenoh timestamp as Unix time; `received_ns`: when it arrived here;
    `sender`: the Zenoh id of the publishing session, "" if unknown.
    """

    key: str
    payload: bytes
    encoding: str
    published_ns: int
    received_ns: int
    attachment: bytes = b""
    sender: str = ""


class Reply(Struct, frozen=True):
    """An answer to a query; `error` is one line if the other side refused, else ""."""

    key: str
    payload: bytes
    error: str = ""


class Bell:
    """Wakes a thread that waits for new samples. Any thread may ring it, any number of times.

    It is a bare lock, held while nothing has arrived. A Condition wakes its waiter while the waker
    still holds the lock, which takes twice as long (49 against 23 µs).
    """

    def __init__(self) -> None:
        self._is_silent = threading.Lock()
        self._is_silent.acquire()

    def ring(self) -> None:
        if self._is_silent.locked():
            with suppress(RuntimeError):  # another thread released it first
                self._is_silent.release()

    def wait(self, timeout_s: float) -> bool:
        """Wait for a ring since the last wait; false on timeout."""
        return self._is_silent.acquire(timeout=max(0.0, timeout_s))


class Incoming(Protocol):
    """What comes in on one key expression, counted."""

    @property
    def depth(self) -> int:
        """Number of samples waiting."""
        ...

    @property
    def received(self) -> int:
        """Number of samples received."""
        ...

    @property
    def dropped(self) -> int:
        """Number of samples lost: dropped since too many waited, or missed in transit."""
        ...

    def close(self) -> None: ...


class Subscription(Incoming, Protocol):
    """Samples of one key expression, in order of arrival."""

    def take(self, timeout_s: float) -> Sample | None:
        """The next sample, or None on timeout or once the subscription is closed."""
        ...

    @property
    def losses(self) -> dict[str, int]:
        """Number of samples dropped from the full queue, by key."""
        ...


class Latest(Incoming, Protocol):
    """Of each key of an expression the newest sample; those that it replaces are no loss."""

    def take(self) -> list[Sample]:
        """The newest sample of each key that has one since the last call; never waits."""
        ...


class Publisher(Protocol):
    """Sends on one key."""

    def put(self, payload: bytes, *, attachment: bytes = b"") -> None:
        """Queue the payload for sending. Never blocks on a subscriber, so threads that read a port
        or a camera may call it."""
        ...

    @property
    def has_listener(self) -> bool:
        """Whether anyone subscribes to the key now (pictures are made only if so)."""
        ...

    def close(self) -> None: ...


class Closable(Protocol):
    """A declaration that can be withdrawn."""

    def close(self) -> None: ...


class Bus(Protocol):
    """An open session."""

    @property
    def identity(self) -> str:
        """The session's Zenoh id, as it appears in `Sample.sender`."""
        ...

    @property
    def locators(self) -> tuple[str, ...]:
        """The endpoints where this session listens, in the form that `bus.connect` takes."""
        ...

    @property
    def peers(self) -> tuple[str, ...]:
        """Ids of the sessions that this one is connected to."""
        ...

    @property
    def warning(self) -> str:
        """What will soon end the connection (an expiring certificate), "" if nothing will."""
        ...

    @property
    def certificate_days(self) -> float | None:
        """Days until the session's certificate runs out, None if it shows none."""
        ...

    @property
    def unreached(self) -> tuple[str, ...]:
        """The endpoints in `bus.connect`, while the session is connected to nobody."""
        ...

    @property
    def unsent(self) -> int:
        """Number of samples never sent, because earlier ones were not taken in time."""
        ...

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything put so far is sent; return false on timeout."""
        ...

    def catch_up(self, site: str, timeout_s: float) -> bool:
        """Wait until everything that the site's other sessions have already sent reliably is here;
        return whether all of them answered in time."""
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
        """Subscribe with the topic's delivery and queue.

        `wanted`: says whether to keep a key's samples; called on the bus's thread. `in_turns`: keys
        and senders take turns; otherwise samples are taken in order of arrival. `bell`: rung at
        each arrival.
        """
        ...

    def latest(self, topic: Topic, expression: str) -> Latest:
        """Subscribe with the topic's delivery, for the newest sample of each key alone."""
        ...

    def declare_alive(self, key: str) -> Closable:
        """Declare a liveliness token."""
        ...

    def alive(self, expression: str, *, timeout_s: float = COMMAND_TIMEOUT_S) -> list[str]:
        """The tokens alive now; those of sessions that do not answer in time are missing."""
        ...

    def serve(self, key: str, answer: Callable[[bytes], bytes]) -> Closable:
        """Answer queries on `key` on a thread of ours.

        `answer` gets the request's payload and returns the reply's. If it raises a TrigpointError,
        the reply is an error with that text; any other exception is reported as such.
        """
        ...

    def query(
        self, key: str, payload: bytes = b"", *, timeout_s: float = COMMAND_TIMEOUT_S
    ) -> list[Reply]:
        """Ask everyone who serves `key`; an empty list if nobody answers in time."""
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...
