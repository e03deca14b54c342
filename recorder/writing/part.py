"""One file of a session: the site's files attached, what is kept repeated, losses noted."""

import json
from bisect import bisect_left
from collections.abc import Collection, Mapping, Sequence
from operator import attrgetter
from pathlib import Path

from msgspec import Struct

from trigpoint.recorder.mcap.chunk import Compression
from trigpoint.recorder.mcap.writer import McapWriter, Message
from trigpoint.recorder.session.files import CLOCK, LOSSES, PART

from .log_times import ClockJump


class AttachedFile(Struct, frozen=True):
    """A file that every part of a session carries."""

    name: str
    data: bytes
    media_type: str
    time_ns: int


class Part:
    """A part being written, by one thread. Raises OperationError as McapWriter does."""

    def __init__(
        self,
        path: Path,
        *,
        session: str,
        number: int,
        files: Collection[AttachedFile],
        latched: Mapping[str, Message],
        start_ns: int,
        compression: Compression,
    ) -> None:
        """`latched`: by key, the last value that late joiners are given; a part after the first
        begins with these, at the log time `start_ns`."""
        self.number, self.start_ns = number, start_ns
        self.writer = McapWriter(path, compression=compression)
        self._last_ns = start_ns if latched else 0
        values = {"session": session, "part": str(number), "repeated": ",".join(latched)}
        self.writer.note(PART, values)
        for file in files:
            self.attach(file)
        self.add(list(latched.values()))

    @property
    def last_ns(self) -> int:
        """The last log time that was added."""
        return self._last_ns

    @property
    def path(self) -> Path:
        return self.writer.path

    def attach(self, file: AttachedFile) -> None:
        self.writer.attach(file.name, file.data, file.media_type, time_ns=file.time_ns)

    def add(self, messages: Sequence[Message]) -> None:
        """Append messages in the order of their log times. One that comes after its log time was
        written already (the bus's threads were late by more than the sink waits) gets the last
        one's."""
        late = bisect_left(messages, self._last_ns, key=attrgetter("log_ns"))
        if late:
            in_time = [m._replace(log_ns=self._last_ns) for m in messages[:late]]
            messages = [*in_time, *messages[late:]]
        if messages:
            self._last_ns = messages[-1].log_ns
            self.writer.extend(messages)

    def note(self, losses: Mapping[str, int], jumps: Collection[ClockJump]) -> None:
        """Write what was lost so far, and how the clock was set."""
        if losses:
            self.writer.note(LOSSES, {key: str(count) for key, count in losses.items()})
        if jumps:
            self.writer.note(CLOCK, {str(j.log_ns): json.dumps(j.seconds) for j in jumps})

    def finish(self, losses: Mapping[str, int], jumps: Collection[ClockJump]) -> None:
        """Write the rest and close."""
        try:
            self.writer.flush()
            self.note(losses, jumps)
        except BaseException:
            self.writer.abandon()
            raise
        self.writer.finish()

    def abandon(self) -> None:
        """Close without writing any more, after an error."""
        self.writer.abandon()
