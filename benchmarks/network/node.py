"""One node of a network benchmark in a process of its own: sends numbered messages, counts others'.

`python -m benchmarks.network.node ROLE SITE SECONDS LINGER`. On standard output it says «ready»;
with the next line on standard input it begins; after SECONDS, or LINGER at most later where those
who listen were away, it says what it sent, and with a line of what all have sent it goes on until
that has come or LINGER seconds are over. Its last line is what came of each key: number, when sent
and when come in nanoseconds of the monotonic clock, which all namespaces share.
"""

import json
import struct
import sys
import threading
import time
from array import array
from collections.abc import Mapping
from pathlib import Path
from uuid import UUID

from msgspec import Struct

from trigpoint.base.ending import ENDING
from trigpoint.bus.bus import Bus, Publisher, Sample, Subscription
from trigpoint.contract import topics
from trigpoint.contract.access import Kind
from trigpoint.contract.correction import CorrectionMark, MissedCorrections
from trigpoint.contract.topics import Topic
from trigpoint.site.config import load_site
from trigpoint.zenoh import open_bus

Came = tuple[int, int, int]

_STAMP = struct.Struct("<Qq")
PICTURE_BYTES = 60_000
_BACK_S = 2.0
"""So long is sent to who listens again: what was held up comes after what is new."""


class Sent(Struct, frozen=True):
    """Messages of one key: how many a second, of how many bytes; `is_unasked`: pictures too are
    sent although nobody listens."""

    topic: Topic
    name: str
    rate: float
    size: int
    is_unasked: bool = False


NODES: dict[str, tuple[tuple[Kind, str], tuple[Sent, ...], tuple[Topic, ...]]] = {
    "camera": (
        (Kind.CAMERA, "c1"),
        (Sent(topics.SIGHTINGS, "c1", 10.0, 1200), Sent(topics.IMAGE, "c1", 30.0, PICTURE_BYTES)),
        (),
    ),
    "robot": (
        (Kind.ROBOT, "r1"),
        (Sent(topics.ODOMETRY, "r1", 50.0, 700),),
        (topics.CORRECTION,),
    ),
    "fusion": (
        (Kind.FUSION, "fusion"),
        (Sent(topics.CORRECTION, "r1", 10.0, 500),),
        (topics.ODOMETRY, topics.SIGHTINGS),
    ),
    "viewer": ((Kind.VIEWER, "bob"), (), (topics.IMAGE,)),
    # What a broken or a stolen camera can do within its rules: large pictures, and garbage.
    "flood": (
        (Kind.CAMERA, "c2"),
        (
            Sent(topics.IMAGE, "c2", 1000.0, 200_000, is_unasked=True),
            Sent(topics.SIGHTINGS, "c2", 1000.0, 17),
        ),
        (),
    ),
}
"""Who shows what certificate, sends what, and listens to what."""


def main() -> None:
    role, path, seconds, linger_s = sys.argv[1], Path(sys.argv[2]), *map(float, sys.argv[3:])
    me, sent, heard = NODES[role]
    site = load_site(path)
    stopping = threading.Event()
    with open_bus(site, me) as bus:
        # A robot may hear its own corrections alone.
        name = me[1] if role == "robot" else "*"
        subscriptions = {t.name: bus.subscribe(t, t.key(site.name, name)) for t in heard}
        came = {name: array("q") for name in subscriptions}  # so that an hour's take little memory
        print("ready", flush=True)
        sys.stdin.readline()  # until everyone is
        senders = [Sender(bus, site.name, one, seconds, linger_s) for one in sent]
        listeners = [
            threading.Thread(target=_listen, args=(subscription, came[name], stopping))
            for name, subscription in subscriptions.items()
        ]
        for thread in (*senders, *listeners):
            thread.start()
        for sender in senders:
            sender.join()
        if not senders:
            time.sleep(seconds)
        print(json.dumps({sender.name: sender.count for sender in senders}), flush=True)
        expected = json.loads(sys.stdin.readline())
        deadline = time.monotonic() + linger_s
        while time.monotonic() < deadline and not _is_all_there(subscriptions, expected):
            time.sleep(0.1)
        stopping.set()
        for listener in listeners:
            listener.join()
        missed = {name: subscription.dropped for name, subscription in subscriptions.items()}
        rows = {name: _rows(numbers) for name, numbers in came.items()}
        if topics.CORRECTION.name in missed:
            missed[topics.CORRECTION.name] = _missed_corrections(rows[topics.CORRECTION.name])
    print(json.dumps({"came": rows, "missed": missed}))
    ENDING.leave(0)  # a session that did not close in time would break off the end of Python


def _is_all_there(subscriptions: Mapping[str, Subscription], expected: dict[str, int]) -> bool:
    """Whether all came or was told to be missing, but for what nobody recovers."""
    return all(
        subscription.received + subscription.dropped >= expected[name]
        for name, subscription in subscriptions.items()
        if name not in (topics.IMAGE.name, topics.CORRECTION.name)
    )


class Sender(threading.Thread):
    """Sends one key's messages at their rate; `count`: how many."""

    def __init__(self, bus: Bus, site: str, sent: Sent, seconds: float, linger_s: float) -> None:
        super().__init__(name=sent.topic.name)
        self._publisher = bus.publisher(sent.topic, sent.topic.key(site, sent.name))
        self._sent, self._seconds, self._linger_s = sent, seconds, linger_s
        self.count = 0

    def run(self) -> None:
        filling = bytes(self._sent.size - _STAMP.size)
        due = time.monotonic()
        until = due + self._seconds
        latest = until + self._linger_s
        while (now := time.monotonic()) < until:
            if self._sent.topic is not topics.IMAGE and not self._publisher.has_listener:
                until = max(until, min(now + _BACK_S, latest))
            time.sleep(max(0.0, due - time.monotonic()))
            if _is_wanted(self._publisher, self._sent):
                stamp = _STAMP.pack(self.count, time.monotonic_ns())
                self._publisher.put(stamp + filling)
                self.count += 1
            due += 1 / self._sent.rate


def _is_wanted(publisher: Publisher, sent: Sent) -> bool:
    """Pictures leave a camera only while somebody listens."""
    return sent.is_unasked or sent.topic is not topics.IMAGE or publisher.has_listener


def _listen(subscription: Subscription, came: "array[int]", stopping: threading.Event) -> None:
    while not stopping.is_set():
        sample = subscription.take(0.2)
        if sample is not None:
            came.extend(_row(sample))
    while (sample := subscription.take(0.0)) is not None:
        came.extend(_row(sample))


def _rows(numbers: "array[int]") -> list[Came]:
    return list(zip(numbers[0::3], numbers[1::3], numbers[2::3], strict=True))


def _row(sample: Sample) -> Came:
    number, sent_ns = _STAMP.unpack_from(sample.payload)
    return number, sent_ns, time.monotonic_ns()


def _missed_corrections(rows: list[Came]) -> int:
    """How many a bridge counts as missed: nobody else asks for them."""
    missed, map_id = MissedCorrections(), UUID(int=0)
    return sum(missed.before(CorrectionMark(map_id, number), "") for number, _, _ in rows)


if __name__ == "__main__":
    main()
