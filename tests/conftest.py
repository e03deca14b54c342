"""What every test gets: a failure where it leaves a thread behind, and a process put back."""

import gc
import logging
import os
import secrets
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from support.commands import Cli

from trigpoint.base.ending import ENDING

# As the program does it, and before numpy is loaded: BLAS threads only get in each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Images of containers forbid Python to keep what it compiled: each of the hundred programs that the
# tests start would compile all modules again, and so would each of the processes that run tests.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A shell has what it starts in the background ignore these, and so would every program that a test
# starts and means to end by them.
for _number, _usual in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _usual)

# A deadline would assert a speed, and so does the look at how slow examples are made. Every run
# draws the same ones, so that a change is not stopped by what another one broke;
# TRIGPOINT_EXPLORE=1 draws others.
settings.register_profile(
    "trigpoint",
    deadline=None,
    derandomize="TRIGPOINT_EXPLORE" not in os.environ,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("trigpoint")

_PATIENCE_S = 20.0


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """All that is collected stays: a third of a million objects that are not to be gone through for
    garbage while they are made, nor in any test."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


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


@pytest.fixture(autouse=True)
def process_is_put_back(no_thread_is_left: None) -> Iterator[None]:
    """Undo what a command sets for its whole process: signals, that it was told to end, the log."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    root, ours = logging.getLogger(), logging.getLogger("trigpoint")
    log = (list(root.handlers), root.level, ours.level)
    yield
    ENDING.forget()
    for number, handler in handlers.items():
        signal.signal(number, handler)
    root.handlers[:] = log[0]
    root.setLevel(log[1])
    ours.setLevel(log[2])


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """What is entered in it is left at the test's end."""
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    """Runs a command, and tells what it says."""
    return Cli(capsys)


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """The service manager's end of the socket that its services notify it on."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.setblocking(False)
        yield receiver


@pytest.fixture(scope="session")
def free_port() -> Callable[[], int]:
    """Ports of the loopback interface that nobody uses now, for connections or for datagrams; none
    of those that the system gives to connections, any of which may have it before who asked for it
    here."""

    def pick() -> int:
        while True:
            port = secrets.choice(range(20_000, 30_000))
            datagrams = socket.socket(type=socket.SOCK_DGRAM)
            with suppress(OSError), datagrams, socket.create_server(("127.0.0.1", port)):
                datagrams.bind(("127.0.0.1", port))
                return port

    return pick
