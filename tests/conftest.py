"""What every test gets: a failure where it leaves a thread behind."""

import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest

_PATIENCE_S = 3.0


def _living() -> set[threading.Thread]:
    # Threads that a library's own code entered Python on are no Thread objects of anyone.
    return {t for t in threading.enumerate() if not isinstance(t, threading._DummyThread)}


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    """Fail the test where a thread that it started still runs."""
    before = _living()
    yield
    deadline = time.monotonic() + _PATIENCE_S
    while (left := _living() - before) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not left, f"left running: {sorted(thread.name for thread in left)}"


@pytest.fixture
def free_port() -> Callable[[], int]:
    """Ports of the loopback interface that nobody uses now."""

    def pick() -> int:
        with socket.create_server(("127.0.0.1", 0)) as server:
            return server.getsockname()[1]

    return pick
