"""The recorder: writes every key of a site to a session or a ring, and serves commands."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from trigpoint.base.clock import Clock, SystemClock, to_ns
from trigpoint.base.disk import free_bytes
from trigpoint.base.ending import ENDING
from trigpoint.base.errors import InputError, OperationError
from trigpoint.bus.bus import Bus, Sample
from trigpoint.contract.messages import Diagnostics, Message
from trigpoint.contract.topics import Topic, command_key
from trigpoint.map.network import decode_network
from trigpoint.node.node import Node
from trigpoint.node.peers import SERVERS
from trigpoint.node.watchdog import Pulse
from trigpoint.site.config import Site

from .mcap.chunk import Compression
from .session.files import FILE, session_path
from .session.recording import NETWORK_ATTACHMENT
from .writing.attachments import site_files
from .writing.free_space import Room
from .writing.intake import Intake, is_wanted, recorded_topics
from .writing.part import AttachedFile
from .writing.ring import MovedCameras, Ring
from .writing.sink import McapSink, SinkSettings

__all__ = ["COMMANDS", "FILE", "KIND", "NAME", "Recorder", "session_path", "site_files"]

KIND = "recorder"
NAME = SERVERS[KIND]
COMMANDS = ("start", "stop", "split", "save", "status")
"""Queryables under {site}/recorder/; each replies with the status as JSON."""
_NETWORK_PERIOD_S = 10.0
_NETWORK_TIMEOUT_S = 1.0
# A worn SD card may take half a minute to synchronise; meanwhile messages wait in memory.
_DISK_S = 60.0
_INTERRUPTED = "recording"


class Recorder:
    """A session file with its attachments, and the node's threads that fill it.

    Its `with` block encloses the node's, so that the node's threads have ended when it attaches the
    network and finishes the file.
    """

    def __init__(
        self,
        site: Site,
        path: Path,
        *,
        clock: Clock | None = None,
        out: Path | None = None,
        ring_s: float = 0.0,
    ) -> None:
        """Create the file with the site's files attached; with `ring_s`, keep that many seconds
        in memory instead, until told to save them. `out`: where further sessions go.

        Raises InputError if one of the site's files is missing or wrong, OperationError if the file
        cannot be written.
        """
        self._site, self._path, self._out = site, path, out
        self._clock = clock or SystemClock()  # the clock that stamps received samples
        now_ns = self._clock.now_ns()
        self._files = [AttachedFile(*file, now_ns) for file in site_files(site)]
        self._network = b""
        self._node: Node | None = None
        self._intake: Intake | None = None
        self._pulse: Pulse | None = None
        self._lock = threading.Lock()  # guards starting and stopping
        self._moved = MovedCameras()
        self._saved_ns = 0
        self._ring_s = ring_s
        self.ring = Ring(ring_s, capacity=site.recorder.ring_bytes) if ring_s else None
        self.last: McapSink | None = None
        """The session being recorded, or else the last one."""
        self._sink: McapSink | None = None
        if self.ring is None:
            self._start(path)

    @property
    def sink(self) -> McapSink:
        """The session being recorded, or else the last one; not available with a ring."""
        assert self.last is not None
        return self.last

    def start(self, bus: Bus, node: Node) -> None:
        """Start the node's threads; they write until the node stops."""
        self._bus, self._node = bus, node
        node.health.gauge("file.depth", self._depth)
        node.health.gauge("disk_free_bytes", lambda: free_bytes(self._path.parent))
        topics = recorded_topics(self._site)
        self._intake = Intake(bus, node, self._site, topics, self._take, self._lose)
        self._pulse = node.watchdog.pulse(f"{node.label} writes", within_s=_DISK_S)
        if self._sink is not None:
            self._sink.watch(self._pulse)
        node.work("network", self._ask_for_network)
        for name in COMMANDS:
            bus.serve(command_key(self._site.name, f"recorder/{name}"), _answer(self, name))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        sink = self._sink
        if sink is None:
            return
        if self._network and error is None:
            sink.attach(NETWORK_ATTACHMENT, self._network, "application/json")
        with ENDING.writing():
            sink.__exit__(kind, error, trace)
        if error is not None and not sink.counts:
            # The node never started: leave nothing behind.
            sink.path.unlink(missing_ok=True)
            sink.path.with_name("metadata.yaml").unlink(missing_ok=True)

    def command(self, name: str) -> dict[str, object]:
        """Execute one of `COMMANDS`; return the status. Raises OperationError if the command does
        not fit the state."""
        with self._lock:
            if name == "start":
                self._start_again()
            elif name == "stop":
                self._stop()
            elif name == "split":
                self._running().split()
            elif name == "save":
                return self._status() | {"saved": str(self._save())}
            return self._status()

    def _status(self) -> dict[str, object]:
        sink = self.last
        state = "recording" if self._sink else "ring" if self.ring else "stopped"
        status: dict[str, object] = {"state": state, "depth": self._depth()}
        if sink is not None:
            status |= {
                "file": str(sink.path),
                "part": sink.part,
                "bytes": sink.size,
                "messages": sum(sink.counts.values()),
                "lost": sink.losses,
                "problem": sink.problem,
            }
        return status

    def _start(self, path: Path) -> None:
        sink = McapSink(
            path, clock=self._clock, settings=settings_of(self._site), complain=self._complain
        )
        for file in self._files:
            sink.attach(file.name, file.data, file.media_type)
        if self._pulse is not None:
            sink.watch(self._pulse)
        self._sink = self.last = sink

    def _start_again(self) -> None:
        if self._sink is not None:
            raise OperationError(f"{self._sink.path} is being recorded already; stop it first")
        if self.ring is not None:
            raise OperationError("this recorder keeps a ring; save it, or start one without --ring")
        self._start(session_path(self._site, self._out, now_ns=self._clock.now_ns()))

    def _stop(self) -> None:
        sink = self._running()
        if self._intake is not None:
            self._intake.settle()
        if self._network:
            sink.attach(NETWORK_ATTACHMENT, self._network, "application/json")
        self._sink = None
        sink.close()

    def _running(self) -> McapSink:
        if self._sink is None:
            raise OperationError("nothing is being recorded; start it first")
        return self._sink

    def _save(self) -> Path:
        if self.ring is None:
            raise OperationError("this recorder keeps no ring; start it with --ring SECONDS")
        path = session_path(self._site, self._out, now_ns=self._clock.now_ns())
        files = self._files
        if self._network:
            now_ns = self._clock.now_ns()
            network = AttachedFile(NETWORK_ATTACHMENT, self._network, "application/json", now_ns)
            files = [*files, network]
        self.ring.save(path, files, settings_of(self._site).compression)
        return path

    def _take(self, topic: Topic, sample: Sample, message: Message) -> None:
        self._write(topic, sample)
        if self.ring is not None and isinstance(message, Diagnostics):
            self._save_where_moved(sample, message)

    def _write(self, topic: Topic, sample: Sample) -> None:
        into = self.ring or self._sink
        if into is None or not is_wanted(self._site, sample.key):
            return
        is_taken = into.write(
            topic,
            sample.key,
            sample.payload,
            log_ns=sample.received_ns,
            published_ns=sample.published_ns,
            attachment=sample.attachment,
        )
        assert self._node is not None
        if is_taken:
            self._node.health.count(f"recorded {sample.key}")
        else:
            self._node.health.lose(f"file {sample.key}")

    def _lose(self, key: str, count: int) -> None:
        """Count samples dropped by the bus's queue in the session too, where they are missing."""
        if self._sink is not None:
            self._sink.lose(key, count)

    def _save_where_moved(self, sample: Sample, diagnostics: Diagnostics) -> None:
        """If fusion says that a camera was moved, save the ring, once per event."""
        is_new = sample.received_ns - self._saved_ns > to_ns(self._ring_s)
        if self._moved.are_more(diagnostics) and is_new:
            self._saved_ns = sample.received_ns
            with self._lock:
                path = self._save()
            assert self._node is not None
            self._node.health.describe("saved", f"{path}: a camera was moved")

    def _depth(self) -> int:
        into = self.ring or self._sink
        return into.depth if into is not None else 0

    def _complain(self, problem: str) -> None:
        if self._node is not None:
            if problem:
                self._node.health.hold(_INTERRUPTED, problem)
            else:
                self._node.health.release(_INTERRUPTED)

    def _ask_for_network(self, pulse: Pulse) -> None:
        """Ask fusion periodically and once at the end, since it may end before the recorder."""
        assert self._node is not None
        key = command_key(self._site.name, "fusion/network")
        while True:
            pulse.beat()
            is_last = self._node.stopping.wait(_NETWORK_PERIOD_S)
            for reply in self._bus.query(key, timeout_s=_NETWORK_TIMEOUT_S):
                if not reply.error and self._is_network(reply.payload):
                    self._network = reply.payload
            if is_last:
                return

    def _is_network(self, payload: bytes) -> bool:
        assert self._node is not None
        try:
            decode_network(payload, source="fusion's network")
        except InputError as reason:
            self._node.health.fail(str(reason))
            return False
        return True


def settings_of(site: Site) -> SinkSettings:
    """How to write a site's sessions, from its site file."""
    wanted = site.recorder
    return SinkSettings(
        compression=Compression[wanted.compression.upper()],
        synchronise_s=wanted.synchronise,
        # So that there are old parts to remove.
        split_bytes=min(filter(None, (wanted.split_bytes, wanted.budget / 8)), default=0.0),
        split_s=wanted.split_time,
        daily=wanted.daily,
        room=Room(
            site.path(wanted.directory),
            wanted.minimum_free,
            wanted.when_full == "free",
            prefix=site.name,
            budget=wanted.budget,
        ),
    )


def _answer(recorder: Recorder, name: str) -> Callable[[bytes], bytes]:
    def answer(_request: bytes) -> bytes:
        return json.dumps(recorder.command(name)).encode()

    return answer
