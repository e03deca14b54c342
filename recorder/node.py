"""The recorder: every key of a site into one MCAP file."""

from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

from trigpoint.bus import Bus, Sample
from trigpoint.clock import NANOSECONDS, Clock, SystemClock
from trigpoint.config import Site
from trigpoint.errors import ConfigError, InputError, TargetError, read_text
from trigpoint.messages import Message
from trigpoint.network import decode_network
from trigpoint.node import Node
from trigpoint.target import parse_target
from trigpoint.topics import Topic, command_key
from trigpoint.watchdog import Pulse

from .intake import Intake, recorded_topics
from .recording import NETWORK_ATTACHMENT, SITE_ATTACHMENT
from .sink_mcap import McapSink

KIND = "recorder"
NAME = "main"
FILE = "session.mcap"
_NETWORK_PERIOD_S = 10.0
_NETWORK_TIMEOUT_S = 1.0
_TOML = "application/toml"
# A worn SD card may take half a minute to synchronise; what waits meanwhile is kept in memory.
_DISK_S = 60.0


class Recorder:
    """A session file with its attachments, and the node's threads that fill it.

    As a context manager it stands outside the node, so that the node's threads have ended when it
    attaches the network and finishes the file.
    """

    def __init__(self, site: Site, path: Path, *, clock: Clock | None = None) -> None:
        """Create the file with the site's files attached.

        Raises InputError where one of those is missing or wrong, OperationError where the file
        cannot be written.
        """
        files = site_files(site)
        self._site = site
        self._network = b""
        self.sink = McapSink(path, clock=clock or SystemClock())
        for name, data, media_type in files:
            self.sink.attach(name, data, media_type)

    def start(self, bus: Bus, node: Node) -> None:
        """Start the node's threads; they write until the node stops."""
        self._bus, self._node = bus, node
        node.health.gauge("file.depth", lambda: self.sink.depth)
        topics = recorded_topics(pictures=self._site.recorder.pictures)
        Intake(bus, node, self._site, topics, self._write)
        self.sink.watch(node.watchdog.pulse(f"{node.label} writes", within_s=_DISK_S))
        node.work("network", self._ask_for_network)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._network and error is None:
            self.sink.attach(NETWORK_ATTACHMENT, self._network, "application/json")
        self.sink.__exit__(kind, error, trace)
        if error is not None and not self.sink.counts:
            self.sink.path.unlink(missing_ok=True)  # refused before it began: leave nothing behind

    def _write(self, topic: Topic, sample: Sample, _message: Message) -> None:
        is_taken = self.sink.write(
            topic,
            sample.key,
            sample.payload,
            log_ns=sample.received_ns,
            published_ns=sample.published_ns,
        )
        if is_taken:
            self._node.health.count(f"recorded {sample.key}")
        else:
            self._node.health.lose("file")

    def _ask_for_network(self, pulse: Pulse) -> None:
        """Ask fusion now and then and once at the end, since it may end before the recorder."""
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
        try:
            decode_network(payload, source="fusion's network")
        except InputError as reason:
            self._node.health.fail(str(reason))
            return False
        return True


def session_path(site: Site, out: Path | None, *, now_ns: int) -> Path:
    """Where to record: `session.mcap` in `out`, or in a new folder of the recorder's directory.

    Where `out` has a session already (a recorder that was killed and started again), the next free
    name is taken: nothing is ever written over.
    """
    if out is None:
        time = datetime.fromtimestamp(now_ns // NANOSECONDS, UTC).strftime("%Y%m%dT%H%M%SZ")
        out = site.path(site.recorder.directory) / f"{site.name}_{time}"
    taken = {file.name for file in out.glob("*.mcap")}
    number = 1
    while (name := FILE if number == 1 else f"session_{number}.mcap") in taken:
        number += 1
    return out / name


def site_files(site: Site) -> list[tuple[str, bytes, str]]:
    """(name as the site file writes it, bytes, media type) of everything that a session needs.

    Raises ConfigError or TargetError where a file is missing or wrong.
    """
    files = [(SITE_ATTACHMENT, site.text.encode(), _TOML)]
    for name in dict.fromkeys(site.target_name(robot) for robot in site.robots):
        path = site.path(name)
        text = read_text(path, "target file", TargetError)
        parse_target(text, file=str(path))
        files.append((name, text.encode(), _TOML))
    lenses = [c.intrinsics for c in site.cameras.values() if not c.estimates_intrinsics]
    for name in dict.fromkeys(name for name in lenses if name):
        text = read_text(site.path(name), "camera_info file", ConfigError)
        files.append((name, text.encode(), "application/yaml"))
    return files
