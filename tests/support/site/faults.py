"""What a site may meet in a week, at drawn moments, while a drive goes on: see `Fire`."""

import random
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from signal import SIGSTOP

import numpy as np
from support.builders import eventually
from support.site.programs import Drive, Field, Program

from trigpoint.base.clock import to_ns
from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import FaceSighting, Odometry, Sightings
from trigpoint.contract.topics import Topic, command_key
from trigpoint.fusion.checkpoint import _records  # pyright: ignore[reportPrivateUsage]
from trigpoint.geometry import Pose

MORE = """
[cameras.noisy]
source = "sim://noisy"
intrinsics = "c1.yaml"

[cameras.twice]
source = "sim://twice"
intrinsics = "c1.yaml"

[robots.other]
port = "loop://"
target = "other.toml"
"""
"""What the fire plays with: neither the drive's robot nor its cameras."""

_SUBSCRIBER = """
import sys, time
from pathlib import Path
from trigpoint.zenoh import open_bus
from trigpoint.site.config import load_site
from trigpoint.contract.topics import ODOMETRY, SIGHTINGS
site = load_site(Path(sys.argv[1]))
with open_bus(site) as bus:
    for topic in (ODOMETRY, SIGHTINGS):
        bus.subscribe(topic, topic.expression("lab"))
    print("ready", flush=True)
    time.sleep(3600)
"""


class Stranger:
    """Somebody's program on the bus."""

    def __init__(self, field: Field) -> None:
        self.bus: Bus = field.session_of_bus()
        self._publishers: dict[str, Publisher] = {}

    def put(self, topic: Topic, name: str, payload: bytes) -> None:
        key = topic.key("lab", name)
        if key not in self._publishers:
            self._publishers[key] = self.bus.publisher(topic, key)
        self._publishers[key].put(payload)


class Fire:
    """Attacks, each a method of no arguments, on a thread of their own."""

    def __init__(self, field: Field, drive: Drive, seed: int) -> None:
        self.field, self.drive, self.draw = field, drive, random.Random(seed)
        self.done: Counter[str] = Counter()
        self._strangers = [Stranger(field) for _ in range(3)]
        self._numbers = np.random.default_rng(seed)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._stopped: subprocess.Popen[str] | None = None

    @property
    def attacks(self) -> dict[str, Callable[[], object]]:
        return {
            "an hour ahead": self.an_hour_ahead,
            "five thousand faces": self.five_thousand_faces,
            "malformed": self.malformed,
            "unknown names": self.unknown_names,
            "flood": self.flood,
            "two under one name": self.two_under_one_name,
            "a subscriber that is stopped": self.stopped_subscriber,
        }

    def start(self) -> None:
        """Begin; every attack comes again and again, until it is closed."""
        self._thread = threading.Thread(target=self._run, name="fire")
        self._thread.start()

    def is_all_done_since(self, before: Counter[str]) -> bool:
        """Whether every attack came once more."""
        return all(self.done[name] > before[name] for name in self.attacks)

    def _run(self) -> None:
        while not self._stopping.is_set():
            names = list(self.attacks)
            self.draw.shuffle(names)
            for name in names:
                if self._stopping.wait(self.draw.uniform(0.0, 1.0)):
                    return
                self.attacks[name]()
                self.done[name] += 1

    def close(self) -> None:
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        stopped, self._stopped = self._stopped, None
        if stopped is not None:
            stopped.kill()
            stopped.communicate()
        for stranger in self._strangers:
            stranger.bus.close()

    # -- the attacks ------------------------------------------------------------------------------

    def an_hour_ahead(self) -> None:
        """By the bridge itself, whose clock is wrong for a moment."""
        ahead_ns = time.time_ns() + to_ns(3600.0)
        self.drive.put("r1", Odometry(ahead_ns, "r1/odom", "r1/base", Pose.identity()))

    def five_thousand_faces(self) -> None:
        self._strangers[0].put(topics.SIGHTINGS, "c1", cdr.encode(self._sightings(5000)))

    def malformed(self) -> None:
        """Flipped bytes, cut ends, other lengths, on the drive's own keys."""
        for _ in range(200):
            payload = bytearray(cdr.encode(self._sightings(2)))
            for _ in range(self.draw.randint(1, 8)):
                payload[self.draw.randrange(4, 60)] = self.draw.randrange(256)
            cut = self.draw.randrange(len(payload))
            self._strangers[0].put(topics.SIGHTINGS, "c2", bytes(payload[:cut]))
            self._strangers[0].put(topics.ODOMETRY, "r1", bytes(payload[:cut]))

    def unknown_names(self) -> None:
        payload = cdr.encode(self._sightings(1))
        for number in range(300):
            self._strangers[1].put(topics.SIGHTINGS, f"x{number}", payload)

    def flood(self) -> None:
        """Two seconds of odometry and of sightings with noise, a thousand a second each."""
        until_s = time.monotonic() + 2.0
        number = 0
        while time.monotonic() < until_s and not self._stopping.is_set():
            now_ns = time.time_ns()
            pose = Pose.planar(0.001 * number, 0.0, 0.0)
            odometry = Odometry(now_ns, "other/odom", "other/base", pose)
            self._strangers[1].put(topics.ODOMETRY, "other", cdr.encode(odometry))
            self._strangers[2].put(topics.SIGHTINGS, "noisy", cdr.encode(self._sightings(2)))
            number += 1
            time.sleep(0.001)

    def two_under_one_name(self) -> None:
        for _ in range(20):
            for stranger in self._strangers[:2]:
                stranger.put(topics.SIGHTINGS, "twice", cdr.encode(self._sightings(1)))
            time.sleep(0.02)

    def stopped_subscriber(self) -> None:
        if self._stopped is not None:
            return
        command = [sys.executable, "-c", _SUBSCRIBER, str(self.field.site_file)]
        self._stopped = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._stopped.stdout is not None
        self._stopped.stdout.readline()
        self._stopped.send_signal(SIGSTOP)

    def _sightings(self, faces: int) -> Sightings:
        """Faces of a target that nobody carries, with corners anywhere."""
        found = tuple(
            FaceSighting(
                "nobody's",
                number % 1000,
                np.arange(8, dtype=np.uint16),
                self._numbers.uniform(0, 480, (8, 2)).astype(np.float32),
                0.2,
            )
            for number in range(faces)
        )
        return Sightings(time.time_ns(), "x/optical", 640, 480, found)


class Watchman:
    """Asks the programs all the while: whether they answer, and what they keep in memory."""

    def __init__(self, bus: Bus, programs: Callable[[], list[Program]]) -> None:
        self._bus, self._programs = bus, programs
        self.unanswered: list[str] = []
        self.most_mb: dict[str, float] = {}
        self.asked = 0
        self.is_paused = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watchman")
        self._thread.start()

    def _run(self) -> None:
        while not self._stopping.wait(0.5):
            for program in self._programs():
                memory = program.resident_mb()
                self.most_mb[program.name] = max(self.most_mb.get(program.name, 0.0), memory)
            for path in () if self.is_paused.is_set() else ("clock", "fusion/map"):
                self.asked += 1
                began_s = time.monotonic()
                if not self._is_answered(path) and not self.is_paused.is_set():
                    after_s = time.monotonic() - began_s
                    self.unanswered.append(f"{path} at {began_s:.0f} s, within {after_s:.1f} s")

    def _is_answered(self, path: str) -> bool:
        """Also by a refusal: there is no map before the first odometry."""
        return bool(self._bus.query(command_key("lab", path), timeout_s=10.0))

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()


def _odometry_in(checkpoint: Path) -> tuple[int, int] | None:
    """Where a record of odometry begins and ends in it; not the first one, which is where the map
    begins."""
    records = islice(_records(checkpoint), 1, None) if checkpoint.exists() else ()
    for each in records:
        if all(key.endswith("/odom") for key, _ in each.messages):
            return each.start, each.end
    return None


def kill_and_restart(fusion: Program, field: Field, start: Callable[[], Program]) -> Program:
    """SIGKILL, a flipped bit in the checkpoint's odometry, and started again."""
    path = field.out / "checkpoint.bin"
    assert eventually(lambda: _odometry_in(path) is not None)
    fusion.kill()
    record, data = _odometry_in(path), bytearray(path.read_bytes())
    assert record is not None
    data[sum(record) // 2] ^= 1
    path.write_bytes(bytes(data))
    again = start()
    assert eventually(lambda: "runs on site" in again.said, 60.0), again.said
    return again
