"""What ten open pages, one of them stopped, do to those who work on the same bus.

A recorder records the site. One process hears the corrections, as robots do, and the sightings, as
fusion does. Both by turns without a page and with ten, of which one is stopped (SIGSTOP) and goes
on at the end; its machine holds 16 kB for it, since no server can know of what is read later.
"""

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.table import Row
from benchmarks.timing import resident_mb
from trigpoint.base.clock import NANOSECONDS
from trigpoint.bus.bus import Subscription
from trigpoint.contract import topics
from trigpoint.contract.cdr_layout import STAMP
from trigpoint.contract.topics import Topic
from trigpoint.recorder.session.recording import open_recording
from trigpoint.site.config import load_site
from trigpoint.zenoh import open_bus

_PAGES, _TURNS = 10, 2
_SETTLED_S, _LAST_S = 5.0, 2.0
"""After which a recorder has taken what was sent before it came; and what was sent is there."""
_BACK_S, _AGAIN_S, _HELD_BYTES = 20.0, 1.0, 16 << 10
_STAMP_AT = 4
_CONTEXT = multiprocessing.get_context("spawn")
_Stamps = dict[str, set[int]]
_row = partial(Row, "page")


class _Heard(Struct):
    """`stamps`: of each key, ns; `late_ms`: corrections, by stamp, from put to taken."""

    stamps: _Stamps = field(default_factory=lambda: defaultdict(set))
    late_ms: list[tuple[int, float]] = field(default_factory=list)


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

    def lost(self, stamps: _Stamps, said_ns: set[int]) -> tuple[int, int]:
        """How many messages of rounds that were `said_ns` did not come on a key, and of how many:
        the site says all that it says in a round at one time."""
        asked = {stamp_ns for stamp_ns in said_ns if self.hold(stamp_ns)}
        return sum(len(asked - own) for own in stamps.values()), len(asked) * len(stamps)


def beside(site: Path, address: str, server: int, seconds: float) -> list[Row]:
    """Rows of ten pages against none; `server`: the board's process."""
    none, ten = _Turns(), _Turns()
    with TemporaryDirectory() as folder:
        with _recording(site, folder), _hearing(site) as heard:
            time.sleep(_SETTLED_S)
            for _ in range(_TURNS):
                none.take(server, seconds)
                with _open_pages(address, ten):
                    ten.take(server, seconds)
            time.sleep(_LAST_S)
        recorded = _recorded(Path(folder))
    return _rows(none, ten, heard[0], recorded)


def _rows(none: _Turns, ten: _Turns, heard: _Heard, recorded: _Stamps) -> list[Row]:
    against = "without a page"
    late_ms, before_ms = (
        float(np.percentile([ms for ns, ms in heard.late_ms if turns.hold(ns)], 95))
        for turns in (ten, none)
    )
    rows = [_row("ten pages, a correction put to taken, p95", "ms", late_ms, before_ms, against)]
    kinds = {
        "corrections": _of(topics.CORRECTION, heard.stamps),
        "sightings": _of(topics.SIGHTINGS, heard.stamps),
        "recorded corrections": _of(topics.CORRECTION, recorded),
        "recorded sightings": _of(topics.SIGHTINGS, recorded),
    }
    # What nobody at all heard or recorded of a round is not told from one that was not said.
    said_ns = set[int]().union(*(own for each in kinds.values() for own in each.values()))
    for name, stamps in kinds.items():
        (lost, sent), (before, _) = ten.lost(stamps, said_ns), none.lost(stamps, said_ns)
        rows.append(_row(f"ten pages, {name} lost of {sent}", "messages", lost, before, against))
    sizes = max(ten.memory_mb), none.memory_mb[0]  # before any page was there
    rows.append(_row("ten pages, server's memory", "MB", *sizes, against))
    what = "ten pages, the stopped one dropped and back"
    return [*rows, _row(what, "times", ten.returns, _TURNS, "how often it was stopped")]


@contextmanager
def _recording(site: Path, folder: str) -> Iterator[None]:
    words = [sys.executable, "-m", "trigpoint", "record", "--site", str(site), "--out", folder]
    recorder = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(60)


@contextmanager
def _hearing(site: Path) -> Iterator[list[_Heard]]:
    """Hear inside the `with` block; gives what was heard, once it is over."""
    over, (ours, theirs) = _CONTEXT.Event(), _CONTEXT.Pipe()
    hearer = _CONTEXT.Process(target=_hear, args=(site, over, theirs), daemon=True)
    hearer.start()
    found: list[_Heard] = []
    try:
        yield found
        over.set()
        if not ours.poll(60):
            raise TimeoutError("who hears beside the pages does not say what was heard")
        found.append(ours.recv())
    finally:
        hearer.kill()
        hearer.join()


def _hear(site_path: Path, over: Event, told: Connection) -> None:
    site, heard = load_site(site_path), _Heard()
    with open_bus(site) as bus:
        subscriptions = {
            topic: bus.subscribe(topic, topic.expression(site.name), in_turns=True)
            for topic in (
                replace(topics.CORRECTION, queue=topics.SIGHTINGS.queue),  # of all robots
                replace(topics.SIGHTINGS, cache=0),
            )
        }
        threads = [
            threading.Thread(target=_take, args=(topic, subscription, heard, over))
            for topic, subscription in subscriptions.items()
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    told.send(heard)


def _take(topic: Topic, subscription: Subscription, heard: _Heard, over: Event) -> None:
    while not over.is_set():
        if (sample := subscription.take(0.2)) is None:
            continue
        stamp_ns = _stamp_ns(sample.payload)
        heard.stamps[sample.key].add(stamp_ns)
        if topic.name == topics.CORRECTION.name:
            heard.late_ms.append((stamp_ns, (time.time_ns() - sample.published_ns) / 1e6))


def _recorded(folder: Path) -> _Stamps:
    found: _Stamps = defaultdict(set)
    for sample in open_recording(folder).samples((topics.SIGHTINGS, topics.CORRECTION)):
        found[sample.key].add(_stamp_ns(sample.payload))
    return found


def _stamp_ns(payload: bytes) -> int:
    seconds, nanoseconds = STAMP.unpack_from(payload, _STAMP_AT)
    return seconds * NANOSECONDS + nanoseconds


def _of(topic: Topic, stamps: _Stamps) -> _Stamps:
    return {key: own for key, own in stamps.items() if topic.match(key)}


@contextmanager
def _open_pages(address: str, turns: _Turns) -> Iterator[None]:
    """Ten pages inside the `with` block, one of them stopped; at its end that one goes on."""
    counts = [_CONTEXT.Value("i"), _CONTEXT.Value("i")]
    numbers = _PAGES - 1, 1
    processes = [
        _CONTEXT.Process(target=_read_pages, args=(address, number, count), daemon=True)
        for number, count in zip(numbers, counts, strict=True)
    ]
    for process in processes:
        process.start()
    try:
        if not _have_come(counts, numbers):
            raise TimeoutError(f"not all of {_PAGES} pages opened within {_BACK_S:.0f} s")
        stopped = processes[1].pid
        assert stopped is not None
        os.kill(stopped, signal.SIGSTOP)
        yield
        os.kill(stopped, signal.SIGCONT)
        turns.returns += _have_come(counts[1:], (2,))
    finally:
        for process in processes:
            process.kill()
            process.join()


def _have_come(counts: "list[Synchronized[int]]", numbers: tuple[int, ...]) -> bool:
    """Whether so many have, before long."""
    deadline = time.monotonic() + _BACK_S
    while any(count.value < number for count, number in zip(counts, numbers, strict=True)):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


def _read_pages(address: str, number: int, count: "Synchronized[int]") -> None:
    """Read pages as a browser does, which come again when they end; `count`: how many have come."""
    threads = [threading.Thread(target=_read_page, args=(address, count)) for _ in range(number)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _read_page(address: str, count: "Synchronized[int]") -> None:
    host = urlsplit(address)
    request = f"GET /events HTTP/1.1\r\nHost: {host.netloc}\r\nAccept-Encoding: gzip\r\n\r\n"
    while True:
        with socket.socket() as page:
            page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _HELD_BYTES)
            try:
                page.connect((host.hostname, host.port))
                page.sendall(request.encode())
                is_first = True
                while page.recv(1 << 16):
                    if is_first:
                        with count.get_lock():
                            count.value += 1
                    is_first = False
            except OSError:
                pass  # the server hung up; so it comes again
        time.sleep(_AGAIN_S)
