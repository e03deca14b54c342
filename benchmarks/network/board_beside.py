"""What ten open pages, one of them stopped, do to who else hears the site.

A recorder takes the sightings and the corrections, as fusion and the robots do; by turns without a
page and with ten, of which one is not read any more and goes on at the end. Its machine holds 16 kB
for it, since no server can know of what is read later.
"""

import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from msgspec import Struct, field
from support.builders import eventually

from benchmarks.table import Row
from benchmarks.timing import resident_mb
from trigpoint.base.clock import NANOSECONDS
from trigpoint.contract import topics
from trigpoint.contract.cdr_layout import STAMP
from trigpoint.recorder.session.recording import RecordedSample, open_recording

_PAGES, _TURNS = 10, 2
_SETTLED_S, _LAST_S = 5.0, 2.0
"""After which a recorder has taken what was sent before it came; and what was sent is there."""
_BACK_S, _AGAIN_S, _STOP_S, _HELD_BYTES = 20.0, 1.0, 60.0, 16 << 10
_STAMP_AT = 4
_row = partial(Row, "page")


class _Turns(Struct):
    """Turns of one kind, from stamp to stamp, with the server's memory at their ends; `returns`:
    how often the stopped page was back."""

    spans_ns: list[tuple[int, int]] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)
    returns: int = 0

    def take(self, server: int, seconds: float) -> None:
        """Let a turn go by."""
        begin_ns = time.time_ns()
        time.sleep(seconds)
        self.spans_ns.append((begin_ns, time.time_ns()))
        self.memory_mb.append(resident_mb(server))

    def hold(self, stamp_ns: int) -> bool:
        """Whether something was said in one of the turns."""
        return any(begin_ns <= stamp_ns < end_ns for begin_ns, end_ns in self.spans_ns)

    def late_ms(self, samples: Sequence[RecordedSample]) -> float:
        """Of their corrections 95 %, from put to received."""
        late_ns = [
            sample.log_ns - sample.published_ns
            for sample in samples
            if sample.topic is topics.CORRECTION and self.hold(_stamp_ns(sample))
        ]
        return float(np.percentile(late_ns or [np.nan], 95)) / 1e6

    def lost(self, keys: Sequence[set[int]], said_ns: set[int]) -> tuple[int, int]:
        """How many messages of rounds that were `said_ns` did not come on their keys, and of how
        many: the site says all that it says in a round at one time."""
        asked = {stamp_ns for stamp_ns in said_ns if self.hold(stamp_ns)}
        return sum(len(asked - own) for own in keys), len(asked) * len(keys)


def beside(site: Path, address: str, server: int, seconds: float) -> list[Row]:
    """Rows of ten pages against none; `server`: the board's process."""
    none, ten = _Turns(), _Turns()
    with TemporaryDirectory() as folder:
        with program("record", "--site", str(site), "--out", folder):
            time.sleep(_SETTLED_S)
            for _ in range(_TURNS):
                none.take(server, seconds)
                with _open_pages(address, ten):
                    ten.take(server, seconds)
            time.sleep(_LAST_S)
        recording = open_recording(Path(folder))
        samples = list(recording.samples((topics.SIGHTINGS, topics.CORRECTION)))
    return _rows(none, ten, samples)


def _rows(none: _Turns, ten: _Turns, samples: list[RecordedSample]) -> list[Row]:
    against = "without a page"
    late_ms = ten.late_ms(samples), none.late_ms(samples)
    rows = [_row("ten pages, a correction put to received, p95", "ms", *late_ms, against)]
    stamps: dict[tuple[str, str], set[int]] = defaultdict(set)
    for sample in samples:
        stamps[sample.topic.name, sample.key].add(_stamp_ns(sample))
    # What came of nothing at all in a round is not told from one that was not said.
    said_ns = set[int]().union(*stamps.values())
    for topic in (topics.CORRECTION, topics.SIGHTINGS):
        keys = [own for (name, _), own in stamps.items() if name == topic.name]
        (lost, sent), (before, _) = ten.lost(keys, said_ns), none.lost(keys, said_ns)
        what = f"ten pages, {topic.name} lost of {sent}"
        rows.append(_row(what, "messages", lost, before, against))
    sizes = max(ten.memory_mb), none.memory_mb[0]  # before any page was there
    rows.append(_row("ten pages, server's memory", "MB", *sizes, against))
    what = "ten pages, the stopped one dropped and back"
    against = "how often it was stopped"
    return [*rows, _row(what, "times", ten.returns, _TURNS, against, more_is_better=True)]


def _stamp_ns(sample: RecordedSample) -> int:
    seconds, nanoseconds = STAMP.unpack_from(sample.payload, _STAMP_AT)
    return seconds * NANOSECONDS + nanoseconds


@contextmanager
def program(*words: str, stdout: int = subprocess.DEVNULL) -> Iterator[subprocess.Popen[str]]:
    """A command of ours inside the `with` block, at whose end it is stopped; `stdout`: a PIPE for
    who reads it."""
    command = [sys.executable, "-u", "-m", "trigpoint", *words]
    with subprocess.Popen(command, stdout=stdout, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.communicate(timeout=_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


def opened(address: str, *, held_bytes: int | None = None) -> socket.socket:
    """The page's stream of events, as a browser asks for it; `held_bytes`: what this machine holds
    for who does not read."""
    host, page = urlsplit(address), socket.socket()
    if held_bytes is not None:
        page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, held_bytes)
    page.connect((host.hostname, host.port))
    request = f"GET /events HTTP/1.1\r\nHost: {host.netloc}\r\nAccept-Encoding: gzip\r\n\r\n"
    page.sendall(request.encode())
    return page


@contextmanager
def _open_pages(address: str, turns: _Turns) -> Iterator[None]:
    """Ten pages inside the `with` block, one of them stopped; at its end that one goes on."""
    stopped, *others = pages = [_Page(address) for _ in range(_PAGES)]
    for page in pages:
        page.start()
    try:
        if not all(page.has_come(1) for page in pages):
            raise TimeoutError(f"not all of {_PAGES} pages opened within {_BACK_S:.0f} s")
        stopped.reads.clear()
        yield
        stopped.reads.set()
        turns.returns += stopped.has_come(2)
    finally:
        for page in (stopped, *others):
            page.is_over.set()
            page.reads.set()
        for page in pages:
            page.join()


class _Page(threading.Thread):
    """Reads a page as a browser does, which comes again when it ends; `reads`: while it is set."""

    def __init__(self, address: str) -> None:
        super().__init__()
        self._address = address
        self._count = 0
        self.reads, self.is_over = threading.Event(), threading.Event()
        self.reads.set()

    def has_come(self, times: int) -> bool:
        """Whether it has, before long."""
        return eventually(lambda: self._count >= times, _BACK_S)

    def run(self) -> None:
        while not self.is_over.is_set():
            # The server may hang up, and the page then comes again.
            with suppress(OSError), opened(self._address, held_bytes=_HELD_BYTES) as page:
                is_first = True
                while page.recv(1 << 16) and not self.is_over.is_set():
                    self._count += is_first
                    is_first = False
                    self.reads.wait()
            self.is_over.wait(_AGAIN_S)
