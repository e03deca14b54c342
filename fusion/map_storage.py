"""The messages that a map is made of, on their way to its checkpoint and back.

The checkpoint is a row of files: `checkpoint.bin`, which is written, and before it
`checkpoint-000001.bin` and so on, each as long as is handy. Once all messages of a file are part of
a past that the map summarises (`past.bin`), the file is removed.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import groupby, islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import MessageError, OperationError
from trigpoint.contract import cdr, cdr_layout, topics
from trigpoint.contract.messages import CameraInfo, Diagnostics, Message, Odometry, Sightings
from trigpoint.site.config import Site

from .checkpoint import (
    CHECKPOINT,
    PAST,
    Checkpoint,
    full_files,
    next_full_file,
    read_checkpoint,
    set_aside,
)
from .intake.admission import AHEAD_NS
from .model.past import ODOMETRY_BEFORE_NS, Past
from .model.readings import Readings
from .past_file import save_past
from .standing_odometry import StandingOdometry

Stored = CameraInfo | Diagnostics | Odometry | Readings | Sightings
"""What a map is made of, as it is read again."""
_RETRY_NS = to_ns(30.0)

_log = logging.getLogger(__name__)


class MapStorage:
    """The checkpoint of one map, in a folder. Not thread-safe.

    `knows`: whether the site file still has the camera or robot of a key; `past`: of the map, whose
    messages are not needed; `most`: messages in one file.
    """

    def __init__(
        self,
        folder: Path,
        site: Site,
        clock: Clock,
        *,
        knows: Callable[[str], bool],
        past: Past | None = None,
        most: int = 20_000,
    ) -> None:
        self._folder, self._site, self._knows, self._past = folder, site, knows, past
        self._path, self._most, self._count = folder / CHECKPOINT, most, 0
        self._clock, self._retry_ns = clock, 0
        self._checkpoint = Checkpoint(self._path, clock)
        self._full = full_files(folder)
        # By file, the newest stamp of odometry or sightings in it, once it is known.
        self._newest_ns: dict[Path, int] = {}
        self._written_ns = max(
            self._checkpoint.written_ns, *(path.stat().st_mtime_ns for path in self._full), 0
        )
        self._begin()

    def _begin(self) -> None:
        self._odometry = {
            name: StandingOdometry(planar=robot.planar) for name, robot in self._site.robots.items()
        }

    @property
    def trouble(self) -> str:
        """Why what comes now is not stored; "" while all is well."""
        return self._checkpoint.trouble

    def read(self, most: int) -> Iterator[Iterator[tuple[str, Stored]]]:
        """(key, what is to be used) of what was stored before this process began, in order, of so
        many messages at once, which are decoded as they are used. Raises OperationError where the
        checkpoint is another site's."""
        for path in [*self._full, self._path]:
            is_last = path == self._path
            messages = self._checkpoint.records() if is_last else read_checkpoint(path)
            while some := list(islice(messages, most)):
                yield self._used(path, some)

    def _used(self, path: Path, some: list[tuple[str, bytes]]) -> Iterator[tuple[str, Stored]]:
        """What is to be used of messages, in order; odometry of one robot as it came in a row."""
        self._count += len(some) if path == self._path else 0
        odometry = {key: self._odometry_of(path, key, some) for key in {key for key, _ in some}}
        taken = Counter[str]()
        for key, run in groupby(some, itemgetter(0)):
            payloads = [payload for _, payload in run]
            found = odometry[key]
            if found is not None:
                readings = found[taken[key] : taken[key] + len(payloads)]
                taken[key] += len(payloads)
                readings = readings[readings.stamps_ns >= self._needed_since_ns(key, Odometry)]
                yield from [(key, readings)] if len(readings) else []
            elif self._is_of_site(path, key):
                yield from ((key, m) for p in payloads if (m := self._message(path, key, p)))

    def _is_of_site(self, path: Path, key: str) -> bool:
        """Whether the site file still has what a key is of. Raises OperationError where it is
        another site's."""
        topic = topics.topic_of(key)
        if topic is None or not key.startswith(f"{self._site.name}/"):
            raise OperationError(
                f"{path}: a checkpoint of another site ({key}); give another --out"
            )
        return topic is topics.DIAGNOSTICS or self._knows(key)

    def _odometry_of(self, path: Path, key: str, some: list[tuple[str, bytes]]) -> Readings | None:
        """The odometry of a key, where it is that and all of it is sound."""
        if topics.topic_of(key) is not topics.ODOMETRY or not self._is_of_site(path, key):
            return None
        read = cdr_layout.odometry_run([payload for other, payload in some if other == key])
        if read is None or read[0].max() > self._latest_ns:
            return None
        readings = Readings(*read)
        self._note(path, int(readings.stamps_ns.max()))
        return readings

    def _message(self, path: Path, key: str, payload: bytes) -> Stored | None:
        """The message of a record; None where it is not to be used."""
        topic = topics.topic_of(key)
        assert topic is not None  # it was asked
        try:
            message = cdr.decode(topic.type_name, payload)
        except MessageError as reason:
            _log.error("%s: a message on %s is left out: %s", path, key, reason)
            return None
        assert isinstance(message, CameraInfo | Diagnostics | Odometry | Sightings)
        if message.stamp_ns > self._latest_ns:
            _log.error("%s: a message on %s is stamped ahead of its time; left out", path, key)
            return None
        if isinstance(message, Odometry | Sightings):
            self._note(path, message.stamp_ns)
        is_needed = message.stamp_ns >= self._needed_since_ns(key, type(message))
        return message if is_needed else None

    @property
    def _latest_ns(self) -> int:
        """No message is stamped later: all of the file came before it was written last."""
        return self._written_ns + AHEAD_NS

    def _needed_since_ns(self, key: str, kind: type[Message]) -> float:
        """The stamp from which on a message is more than a part of the map's past."""
        if self._past is None or kind not in (Odometry, Sightings):
            return -np.inf
        if kind is Sightings:
            return self._past.begin_ns
        return self._past.odometry_since_ns(topics.node_of(key))

    def _note(self, path: Path, stamp_ns: int) -> None:
        """Note the stamp of odometry or sightings in a file."""
        self._newest_ns[path] = max(self._newest_ns.get(path, 0), stamp_ns)

    def store(self, key: str, payload: bytes, message: Message) -> int:
        """Store a message, but of a standing robot's odometry only what is needed; returns how many
        messages the disk did not take."""
        payloads = [payload]
        if isinstance(message, Odometry):
            payloads = self._odometry[topics.node_of(key)].take(message, payload)
        if isinstance(message, Sightings):
            for odometry in self._odometry.values():
                odometry.want(message.stamp_ns)
        if isinstance(message, Odometry | Sightings):
            self._note(self._path, message.stamp_ns)
        self._count += len(payloads)
        lost = sum(not self._checkpoint.write(key, item) for item in payloads)
        if self._count >= self._most:
            self._go_on_in_another_file()
        return lost

    def _go_on_in_another_file(self) -> None:
        full = next_full_file(self._folder)
        self._checkpoint.continue_in_another(full)
        self._count = 0
        if full.exists():
            self._full.append(full)
            self._newest_ns[full] = self._newest_ns.pop(self._path, 0)

    def settle(self, past: Past | None) -> None:
        """Store a past in place of its messages, where that is not done: files that have no others
        are removed."""
        if past is None or past is self._past or self._clock.elapsed_ns() < self._retry_ns:
            return
        try:
            save_past(self._folder / PAST, past, self._site)
            self._past = past
            for path in [path for path in self._full if self._is_over(path, past)]:
                path.unlink(missing_ok=True)
                self._full.remove(path)
        except OSError as reason:
            self._retry_ns = self._clock.elapsed_ns() + _RETRY_NS
            _log.warning(
                "%s: not written (%s); the checkpoint stays longer than it must, and it is tried "
                "again",
                self._folder / PAST,
                reason.strerror,
            )

    def _is_over(self, path: Path, past: Past) -> bool:
        newest_ns = self._newest_ns.get(path)
        return newest_ns is not None and newest_ns < past.begin_ns - ODOMETRY_BEFORE_NS

    def flush(self) -> None:
        """Hand what was stored to the disk, at most twice a second."""
        self._checkpoint.flush()

    def restart(self) -> None:
        """Begin a new map; the old one's files are kept under other names."""
        self._checkpoint.restart()
        for path in [*self._full, self._folder / PAST]:
            with suppress(FileNotFoundError):
                set_aside(path)
        self._full.clear()
        self._newest_ns.clear()
        self._past, self._count = None, 0
        self._begin()

    def close(self) -> None:
        """Store what was held back, and close the file."""
        for robot, odometry in self._odometry.items():
            key = topics.ODOMETRY.key(self._site.name, robot)
            for payload in odometry.rest():
                self._checkpoint.write(key, payload)
        self._checkpoint.close()
