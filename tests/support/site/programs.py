"""A site of real programs for system tests: fusion and others as processes, a drive that is sent to
them as its bridge and its agents would, and whatever else is on the bus."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from signal import SIGKILL, SIGTERM, Signals

from msgspec import Struct
from msgspec.structs import replace
from support.builders import eventually
from support.fusion.drives import EPOCH_NS, Sent, Session, offline

from benchmarks.timing import family, resident_mb
from trigpoint.base.clock import to_ns
from trigpoint.base.ending import LONGEST_END_S
from trigpoint.bus.bus import Bus
from trigpoint.contract import cdr
from trigpoint.contract.topics import command_key
from trigpoint.fusion.inbox import INPUT_TOPICS
from trigpoint.map.network import Network
from trigpoint.site.camera_info import write_camera_info
from trigpoint.site.config import Site, load_site, parse_site
from trigpoint.tools.shapes.text import target_text
from trigpoint.zenoh import open_bus

LEAD_S = 1.0
STOP_LIMIT_S = 3 * LONGEST_END_S
"""Who does not end in order says so by its status; this is for a machine that does much else."""


class Field(Struct, frozen=True):
    """A site's folder, its meeting point, and the drive that happens there."""

    folder: Path
    endpoint: str
    session: Session

    @property
    def site_file(self) -> Path:
        return self.folder / "site.toml"

    @property
    def out(self) -> Path:
        return self.folder / "network"

    @property
    def site(self) -> Site:
        return load_site(self.site_file)

    def session_of_bus(self) -> Bus:
        """One more session on the site's bus, as a program has it."""
        return open_bus(self.site)


def lay_out(folder: Path, port: int, session: Session, *, more: str = "") -> Field:
    """Write a site's files; `more`: further tables of the site file."""
    endpoint = f"tcp/127.0.0.1:{port}"
    lines = [session.inputs.site.text]
    for name, model in session.inputs.lenses.items():
        write_camera_info(folder / f"{name}.yaml", model, name)
        lines[0] = lines[0].replace(
            f'source = "sim://{name}"', f'source = "sim://{name}"\nintrinsics = "{name}.yaml"'
        )
    for name, target in session.inputs.targets.items():
        (folder / f"{name}.toml").write_text(target_text(target))
    lines += [more, f'[bus]\nconnect = ["{endpoint}"]']
    (folder / "site.toml").write_text("\n".join(lines))
    return Field(folder, endpoint, session)


@contextmanager
def meeting_point(field: Field) -> Iterator[Bus]:
    """The session that the others connect to."""
    text = field.site_file.read_text().replace("connect =", "listen =")
    with open_bus(parse_site(text, directory=field.folder)) as bus:
        yield bus


class Program:
    """A command of ours as a process with a group of its own."""

    def __init__(self, field: Field, *words: str, file_limit: int | None = None) -> None:
        command = [sys.executable, "-m", "trigpoint", *words, "--site", str(field.site_file)]
        if file_limit is not None:
            command[1:3] = ["-c", _LIMITED.format(file_limit)]
        self.name = words[0]
        self.log = field.folder / f"{self.name}-{time.monotonic_ns()}.log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        assert eventually(lambda: self.hears(SIGTERM) or self.process.poll() is not None, 60.0)

    def hears(self, number: Signals) -> bool:
        """Whether it has a handler for a signal; before its first lines, Python itself runs."""
        with suppress(OSError):
            status = Path(f"/proc/{self.process.pid}/status").read_text()
            caught = int(status.partition("SigCgt:")[2].split()[0], 16)
            return bool(caught >> (number - 1) & 1)
        return False

    def signal(self, number: Signals, *, to_group: bool = False) -> None:
        with suppress(ProcessLookupError):
            if to_group:
                os.killpg(self.process.pid, number)
            else:
                self.process.send_signal(number)

    def stop(self, number: Signals = SIGTERM, *, to_group: bool = False) -> float:
        """Stop it, and return how long that took, s; -1 where it did not end in time."""
        began_s = time.monotonic()
        self.signal(number, to_group=to_group)
        try:
            self.process.wait(STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            return -1.0
        return time.monotonic() - began_s

    def kill(self) -> None:
        """Whatever it is at, with what it started."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, SIGKILL)
        self.process.wait(STOP_LIMIT_S)

    @property
    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def resident_mb(self) -> float:
        """What it and its children keep in memory, MB."""
        with suppress(OSError):
            return sum(map(resident_mb, family(self.process.pid)))
        return 0.0


_LIMITED = """
import resource, signal
from trigpoint.cli import main
if __name__ == "__main__":
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))
    main()
"""


@contextmanager
def running(field: Field, *words: str, file_limit: int | None = None) -> Iterator[Program]:
    program = Program(field, *words, file_limit=file_limit)
    try:
        yield program
    finally:
        program.kill()


def shifted(sent: Sent, by_ns: int) -> Sent:
    return replace(sent, stamp_ns=sent.stamp_ns + by_ns)


class Drive:
    """Sends the session's messages when they are due, each node by a session of its own, on a
    thread; `factor`: how much faster than they were made."""

    def __init__(self, field: Field, *, factor: float = 1.0) -> None:
        self._field, self._factor = field, factor
        self._stopping = threading.Event()
        # The last one is stamped with the moment at which it is sent, the others before theirs.
        seconds = (field.session.messages[-1][1].stamp_ns - EPOCH_NS) / 1e9
        self._began_ns = time.time_ns() + to_ns(LEAD_S)
        self.start_ns = self._began_ns - to_ns(seconds * (1 - 1 / factor))
        self.messages = tuple(
            (name, shifted(message, self.start_ns - EPOCH_NS))
            for name, message in field.session.messages
        )
        topic_of = {name: INPUT_TOPICS[type(message)] for name, message in self.messages}
        self.buses = {name: field.session_of_bus() for name in sorted(topic_of)}
        self._publishers = {
            name: self.buses[name].publisher(topic, topic.key("lab", name))
            for name, topic in topic_of.items()
        }
        self.thread = threading.Thread(target=self._run, name="drive")
        self.thread.start()

    def put(self, name: str, sent: Sent) -> None:
        """Send something else as one of the drive's nodes."""
        self._publishers[name].put(cdr.encode(sent))

    def _run(self) -> None:
        for name, message in self.messages:
            due_ns = self._began_ns + (message.stamp_ns - self.start_ns) / self._factor
            if self._stopping.wait(max(0.0, (due_ns - time.time_ns()) / 1e9)):
                return
            self._publishers[name].put(cdr.encode(message))

    def finish(self) -> None:
        """Wait until all is sent."""
        self.thread.join()
        for bus in self.buses.values():
            bus.flush(10.0)

    def close(self) -> None:
        self._stopping.set()
        self.thread.join()
        for bus in self.buses.values():
            bus.close()

    def undisturbed(self) -> Network:
        """What comes of these messages where nothing else happens."""
        return offline(replace(self._field.session, messages=self.messages)).network


def answers(bus: Bus, path: str, *, timeout_s: float = 10.0) -> dict | None:
    """A command's answer; None where there is none, or a refusal."""
    for reply in bus.query(command_key("lab", path), timeout_s=timeout_s):
        if not reply.error:
            return json.loads(reply.payload)
    return None
