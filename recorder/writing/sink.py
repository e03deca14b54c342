"""Records into MCAP files on a thread of its own.

A chunk is closed when it is full or half a second old and goes to the operating system at once, so
that a killed recorder loses no more than that. Every five seconds the file is synchronised with the
disk, which limits the loss in a power cut and spares SD cards. A disk error (such as a full disk)
does not end the recording: it is retried in a new part, at growing intervals.
"""

import logging
import threading
import uuid
from collections.abc import Callable
from contextlib import suppress
from itertools import compress
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Self

from msgspec import Struct

from trigpoint.base.clock import Clock, to_ns
from trigpoint.base.errors import OperationError
from trigpoint.contract.topics import Delivery, Topic
from trigpoint.node.watchdog import Pulse
from trigpoint.recorder.mcap.chunk import Compression
from trigpoint.recorder.mcap.rosbag_metadata import PartFacts, write_metadata
from trigpoint.recorder.mcap.writer import Message
from trigpoint.recorder.session.files import part_path

from .free_space import Room
from .log_times import LogTimes
from .part import AttachedFile, Part
from .queue import SinkQueue

CHUNK_AGE_S = 0.5
QUEUE_BYTES = 64 * 2**20
CLOSE_TIMEOUT_S = 10.0
_TICK_S = 0.1
_HOLD_S = 0.05
"""How long a message waits for earlier ones that arrive on another of the bus's threads."""
_ROOM_S = 1.0
_FIRST_RETRY_S, _LONGEST_RETRY_S = 1.0, 60.0
_DAY_NS = to_ns(86_400.0)

_LOG = logging.getLogger(__name__)


class SinkSettings(Struct, frozen=True):
    """How a session is written. `split_bytes`, `split_s`: largest size and duration of a part, 0
    for no limit; `daily`: a new part with each day (UTC); `room`: None if disk space is not
    managed."""

    compression: Compression = Compression.ZSTD
    synchronise_s: float = 5.0
    split_bytes: float = 0.0
    split_s: float = 0.0
    daily: bool = False
    room: Room | None = None


USUAL = SinkSettings()


class McapSink:
    """One session; its methods may be called from any thread and do not wait for the disk."""

    def __init__(
        self,
        path: Path,
        *,
        clock: Clock,
        settings: SinkSettings = USUAL,
        complain: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Create the first part; raise OperationError if that fails or the file exists already.

        `complain` is called on the writing thread with the reason when the recording is
        interrupted, and with "" when it continues.
        """
        self._clock, self._settings, self._complain = clock, settings, complain
        self._first_path = path
        self._times = LogTimes(clock)
        self._session = uuid.uuid4().hex
        self._queue = SinkQueue(QUEUE_BYTES)
        self._files: list[AttachedFile] = []
        self._new_files: list[AttachedFile] = []
        self._latched: dict[str, Message] = {}
        self._held: list[Message] = []
        self._facts: list[PartFacts] = []
        self._counts: dict[str, int] = {}
        self._last_ns = 0
        self._problem = ""
        self._retry_s = _FIRST_RETRY_S
        self._retry_ns = 0
        self._noted: tuple[int, int] = (0, 0)
        self._is_closing = False
        self._wants_split = False
        self._lock = threading.Lock()
        self._pulse: Pulse | None = None
        self._flushed_ns = self._synchronised_ns = self._looked_ns = clock.elapsed_ns()
        self._part_ns, self._part_day = self._flushed_ns, 0
        self._part: Part | None = self._open_part(1)
        self._thread = threading.Thread(target=self._run, name="mcap", daemon=True)
        self._thread.start()

    def watch(self, pulse: Pulse) -> None:
        """Have the writing thread beat this pulse from now on, so that a hung disk is noticed."""
        self._pulse = pulse

    @property
    def path(self) -> Path:
        """The session's first file."""
        return self._first_path

    @property
    def files(self) -> list[Path]:
        """The finished parts, in order, but for those that made room; complete after `close`."""
        return [self._first_path.with_name(fact.name) for fact in self._facts]

    @property
    def part(self) -> int:
        """The number of the current or last part, counted from 1."""
        return self._number

    @property
    def depth(self) -> int:
        """Number of messages waiting for the disk."""
        return self._queue.depth

    @property
    def lost(self) -> int:
        """Number of messages not recorded because the disk was too slow or full."""
        return sum(self._queue.lost.values())

    @property
    def losses(self) -> dict[str, int]:
        """`lost`, by key."""
        return self._queue.lost

    @property
    def problem(self) -> str:
        """Why nothing is being written now, "" if all is well."""
        return self._problem

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages written, by key; complete after `close`."""
        counts = dict(self._counts)
        part = self._part
        if part is not None:
            for key, count in part.writer.counts.items():
                counts[key] = counts.get(key, 0) + count
        return counts

    @property
    def size(self) -> int:
        """Size of the part being written, bytes; 0 between parts."""
        part = self._part
        return part.writer.size if part is not None else 0

    def write(
        self,
        topic: Topic,
        key: str,
        payload: bytes,
        *,
        log_ns: int,
        published_ns: int,
        attachment: bytes = b"",
    ) -> bool:
        """Queue one message; False if the queue is full and the message lost."""
        if self._is_closing:
            self._queue.lose(key)
            return False
        return self._queue.put(Message(log_ns, published_ns, topic, key, payload, attachment))

    def lose(self, key: str, count: int) -> None:
        """Count messages of a key that were lost before they arrived here."""
        self._queue.lose(key, count)

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Attach a file to this part and to all later ones."""
        with self._lock:
            self._new_files.append(AttachedFile(name, data, media_type, self._clock.now_ns()))

    def split(self) -> None:
        """Begin a new part soon."""
        self._wants_split = True

    def close(self) -> None:
        """Write what is waiting and finish the file; raise OperationError if that failed."""
        self._is_closing = True
        self._queue.is_urgent.set()
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            raise OperationError(f"{self.path}: the disk does not answer, so its end is missing")
        if self._problem:
            raise OperationError(self._problem)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except OperationError as reason:
            if error is None:
                raise
            if reason is not error:
                _LOG.error("%s", reason)

    def _run(self) -> None:
        is_last = False
        while not is_last:
            if self._pulse is not None:
                self._pulse.beat()
            self._queue.is_urgent.wait(_TICK_S)
            is_last = self._is_closing
            try:
                self._turn(is_last=is_last)
            except OperationError as reason:
                self._interrupt(str(reason))
            except Exception as reason:  # noqa: BLE001 - whatever a library raises must be told
                _LOG.exception("recording broke off")
                self._interrupt(f"{self.path}: the recording broke off: {reason!r}")
        self._lose_rest()

    def _turn(self, *, is_last: bool) -> None:
        self._times.look()
        self._look_for_room(is_last=is_last)
        if self._part is None:
            if not is_last and self._clock.elapsed_ns() < self._retry_ns:
                return
            self._part = self._open_part(self._number + 1)
            self._problem, self._retry_s = "", _FIRST_RETRY_S
            self._complain("")
        self._attach_new(self._part)
        self._write_waiting(self._part, is_last=is_last)
        self._keep(self._part)
        if is_last:
            self._finish_part(self._part)

    def _write_waiting(self, part: Part, *, is_last: bool) -> None:
        now_ns = self._times.now_ns()
        self._held += self._times.of_all(self._queue.take(), now_ns)
        self._held.sort(key=attrgetter("log_ns"))
        ready = len(self._held) if is_last else _count_until(self._held, now_ns - to_ns(_HOLD_S))
        messages, self._held = self._held[:ready], self._held[ready:]
        for message in messages:
            if message.topic.delivery is Delivery.LAST_VALUE:
                self._latched[message.key] = message
        try:
            part.add(messages)
        finally:
            self._last_ns = part.last_ns
        self._queue.release()

    def _keep(self, part: Part) -> None:
        """Close an old chunk, synchronise when due, begin a new part when due."""
        now_ns = self._clock.elapsed_ns()
        if now_ns - self._flushed_ns >= to_ns(CHUNK_AGE_S):
            part.writer.flush()
            self._flushed_ns = now_ns
        if now_ns - self._synchronised_ns >= to_ns(self._settings.synchronise_s):
            self._note(part)
            part.writer.synchronise()
            self._synchronised_ns = now_ns
        if self._is_split_due(part, now_ns):
            self._wants_split = False
            self._finish_part(part)
            self._part = self._open_part(self._number + 1)

    def _is_split_due(self, part: Part, now_ns: int) -> bool:
        settings = self._settings
        is_large = settings.split_bytes and part.writer.size >= settings.split_bytes
        is_long = settings.split_s and now_ns - self._part_ns >= to_ns(settings.split_s)
        is_of_yesterday = settings.daily and self._day() > self._part_day
        return bool(self._wants_split or is_large or is_long or is_of_yesterday)

    def _day(self) -> int:
        """The number of the day that it is, UTC."""
        return self._clock.now_ns() // _DAY_NS

    def _note(self, part: Part) -> None:
        """Write losses and clock jumps if there are new ones."""
        state = self.lost, len(self._times.jumps)
        if state != self._noted:
            self._noted = state
            part.note(self.losses, self._times.jumps)

    def _open_part(self, number: int) -> Part:
        path = part_path(self._first_path, number)
        latched = self._latched if number > 1 else {}
        is_ours = not path.exists()
        try:
            part = Part(
                path,
                session=self._session,
                number=number,
                files=self._files,
                latched={key: m._replace(log_ns=self._last_ns) for key, m in latched.items()},
                start_ns=self._last_ns,
                compression=self._settings.compression,
            )
        except OperationError:
            if is_ours:  # an incomplete file that would block the next try
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            raise
        self._number = number
        self._part_ns, self._part_day = self._clock.elapsed_ns(), self._day()
        self._write_metadata(PartFacts(path.name, (0, 0), {}))
        return part

    def _finish_part(self, part: Part) -> None:
        part.finish(self.losses, self._times.jumps)
        self._put_away(part)
        self._write_metadata()

    def _put_away(self, part: Part) -> None:
        self._part = None
        counts = part.writer.counts
        self._facts.append(PartFacts(part.path.name, part.writer.times_ns, counts))
        for key, count in counts.items():
            self._counts[key] = self._counts.get(key, 0) + count

    def _write_metadata(self, *more: PartFacts) -> None:
        try:
            write_metadata(self._first_path.parent, [*self._facts, *more])
        except OSError as reason:
            raise OperationError(
                f"{self._first_path.parent}: metadata.yaml cannot be written ({reason.strerror})"
            ) from None

    def _attach_new(self, part: Part) -> None:
        with self._lock:
            new, self._new_files = self._new_files, []
        for file in new:
            self._files = [*(f for f in self._files if f.name != file.name), file]
            part.attach(file)

    def _look_for_room(self, *, is_last: bool) -> None:
        now_ns = self._clock.elapsed_ns()
        room, part = self._settings.room, self._part
        if room is None or is_last or now_ns - self._looked_ns < to_ns(_ROOM_S):
            return
        self._looked_ns = now_ns
        problem = room.problem(self._first_path.parent, self.files)
        is_there = [file.exists() for file in self.files]
        self._facts = list(compress(self._facts, is_there))
        if problem:
            if part is not None:
                self._finish_part(part)
            self._say(problem)
            self._retry_ns = now_ns + to_ns(_ROOM_S)  # until the next look

    def _interrupt(self, problem: str) -> None:
        """After an error: keep what is in no chunk yet and retry later, at growing intervals."""
        part, self._part = self._part, None
        if part is not None:
            part.abandon()
            self._held = [*part.writer.unwritten(), *self._held]
            self._last_ns = part.writer.times_ns[1]
            self._put_away(part)
        self._say(problem)
        self._retry_ns = self._clock.elapsed_ns() + to_ns(self._retry_s)
        self._retry_s = min(2 * self._retry_s, _LONGEST_RETRY_S)

    def _say(self, problem: str) -> None:
        if problem != self._problem:
            _LOG.error("%s", problem)
        self._problem = problem
        self._complain(problem)

    def _lose_rest(self) -> None:
        for message in [*self._held, *self._queue.take()]:
            self._queue.lose(message.key)


def _count_until(messages: list[Message], until_ns: int) -> int:
    """How many of the sorted messages are no later than a log time."""
    count = len(messages)
    while count and messages[count - 1].log_ns > until_ns:
        count -= 1
    return count
