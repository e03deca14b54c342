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
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.table import Row
from benchmarks.timing import in_new_process, resident_mb
from trigpoint.bus.bus import Subscription
from trigpoint.contract import topics
from trigpoint.contract.cdr_layout import STAMP
from trigpoint.contract.topics import Topic
from trigpoint.recorder.session.recording import open_recording
from trigpoint.site.config import load_site
from trigpoint.zenoh import open_bus

_PAGES, _TURNS = 10, 2
_SETTLED_S = 5.0
"""After which a recorder has taken what was sent before it came."""
_STAMP_AT = 4
_EDGE = 20
"""Messages of each key at either end of a turn that are not asked for: two seconds' worth."""
_BACK_S, _AGAIN_S, _HELD_BYTES = 20.0, 1.0, 16 << 10
_CONTEXT = multiprocessing.get_context("spawn")
_Stamps = dict[str, set[bytes]]
_row = partial(Row, "page")


class _Turn(Struct):
    """What came in one turn, and the server's memory at its end. `late_ms`: corrections, from put
    to taken; `lost`: corrections, sightings and what the recorder was to write, of which `sent`."""

    late_ms: list[float]
    lost: dict[str, int]
    sent: dict[str, int]
    memory_mb: float
    drops: int = 0


class _Heard(Struct):
    stamps: _Stamps = field(default_factory=lambda: defaultdict(set))
    late_ms: list[float] = field(default_factory=list)


def beside(site: Path, address: str, server: int, seconds: float) -> list[Row]:
    """Rows of ten pages against none; `server`: the board's process."""
    without: list[_Turn] = []
    with_pages: list[_Turn] = []
    for _ in range(_TURNS):
        without.append(_turn(site, server, seconds))
        with _open_pages(address) as drops:
            with_pages.append(_turn(site, server, seconds))
        with_pages[-1].drops = drops[0]
    return _rows(without, with_pages)


def _rows(without: list[_Turn], with_pages: list[_Turn]) -> list[Row]:
    late, before = (
        float(np.percentile([ms for turn in turns for ms in turn.late_ms], 95))
        for turns in (with_pages, without)
    )
    what = "ten pages, a correction put to taken, p95"
    rows = [_row(what, "ms", late, before, "without a page")]
    for name in with_pages[0].lost:
        lost, none = (sum(turn.lost[name] for turn in turns) for turns in (with_pages, without))
        against = f"without a page; of {sum(turn.sent[name] for turn in with_pages)}"
        rows.append(_row(f"ten pages, {name} lost", "messages", lost, none, against))
    most, before = (max(turn.memory_mb for turn in turns) for turns in (with_pages, without))
    rows.append(_row("ten pages, server's memory", "MB", most, before, "without a page"))
    drops = sum(turn.drops for turn in with_pages)
    against = "stopped, dropped and back"
    return [*rows, _row("ten pages, the stopped one was back", "times", drops, _TURNS, against)]


def _turn(site: Path, server: int, seconds: float) -> _Turn:
    with TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "trigpoint", "record", "--site", str(site), "--out", folder]
        recorder = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            time.sleep(_SETTLED_S)
            heard = in_new_process(_hear, site, seconds)
            memory_mb = resident_mb(server)
        finally:
            recorder.send_signal(signal.SIGINT)
            recorder.wait(60)
        recorded = _recorded(Path(folder))
    kinds = {
        "corrections": _of(topics.CORRECTION, heard.stamps),
        "sightings": _of(topics.SIGHTINGS, heard.stamps),
        "recorded sightings": _of(topics.SIGHTINGS, recorded),
        "recorded poses": _of(topics.ROBOT_POSE, recorded),
    }
    counts = {name: _lost(stamps) for name, stamps in kinds.items()}
    lost = {name: lost for name, (lost, _) in counts.items()}
    return _Turn(heard.late_ms, lost, {name: of for name, (_, of) in counts.items()}, memory_mb)


def _hear(site_path: Path, seconds: float) -> _Heard:
    site, heard = load_site(site_path), _Heard()
    with open_bus(site) as bus:
        over = threading.Event()
        subscriptions = {
            topic: bus.subscribe(topic, topic.expression(site.name), in_turns=True)
            for topic in (topics.CORRECTION, replace(topics.SIGHTINGS, cache=0))
        }
        threads = [
            threading.Thread(target=_take, args=(topic, subscription, heard, over))
            for topic, subscription in subscriptions.items()
        ]
        for thread in threads:
            thread.start()
        over.wait(seconds)
        over.set()
        for thread in threads:
            thread.join()
    return heard


def _take(topic: Topic, subscription: Subscription, heard: _Heard, over: threading.Event) -> None:
    while not over.is_set():
        if (sample := subscription.take(0.2)) is None:
            continue
        heard.stamps[sample.key].add(_stamp(sample.payload))
        if topic is topics.CORRECTION:
            heard.late_ms.append((time.time_ns() - sample.published_ns) / 1e6)


def _recorded(folder: Path) -> _Stamps:
    found: _Stamps = defaultdict(set)
    for sample in open_recording(folder).samples((topics.SIGHTINGS, topics.ROBOT_POSE)):
        found[sample.key].add(_stamp(sample.payload))
    return found


def _stamp(payload: bytes) -> bytes:
    """Of a message's header: the site says all that it says in a turn at one time."""
    return payload[_STAMP_AT : _STAMP_AT + STAMP.size]


def _of(topic: Topic, stamps: _Stamps) -> _Stamps:
    return {key: own for key, own in stamps.items() if topic.match(key)}


def _lost(stamps: _Stamps) -> tuple[int, int]:
    """How many messages did not come on a key while others of their time did, and of how many."""
    order = sorted(set().union(*stamps.values()), key=STAMP.unpack)
    asked = set(order[_EDGE:-_EDGE])
    return sum(len(asked - own) for own in stamps.values()), len(asked) * len(stamps)


@contextmanager
def _open_pages(address: str) -> Iterator[list[int]]:
    """Ten pages inside the `with` block; gives how often the stopped one was back, once it is
    over."""
    counts = [_CONTEXT.Value("i"), _CONTEXT.Value("i")]
    numbers = _PAGES - 1, 1
    processes = [
        _CONTEXT.Process(target=_read_pages, args=(address, number, count), daemon=True)
        for number, count in zip(numbers, counts, strict=True)
    ]
    for process in processes:
        process.start()
    drops: list[int] = []
    try:
        _wait_for(counts, numbers)
        stopped = processes[1].pid
        assert stopped is not None
        os.kill(stopped, signal.SIGSTOP)
        yield drops
        os.kill(stopped, signal.SIGCONT)
        _wait_for(counts[1:], (2,))
        drops.append(counts[1].value - 1)
    finally:
        for process in processes:
            process.kill()
            process.join()


def _wait_for(counts: "list[Synchronized[int]]", numbers: tuple[int, ...]) -> None:
    deadline = time.monotonic() + _BACK_S
    while any(count.value < number for count, number in zip(counts, numbers, strict=False)):
        if time.monotonic() > deadline:
            return
        time.sleep(0.1)


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
