"""The folder of a demo: what is written before a run, and where everything lies."""

import os
from pathlib import Path

import msgspec
from msgspec import Struct

from trigpoint.base.disk import replace_file
from trigpoint.base.errors import InputError, OperationError, read_text, writing
from trigpoint.site.config import BusConfig
from trigpoint.tools.simulation.site_files import robot_port, write_site
from trigpoint.tools.simulation.world import World

MARKER = "demo.json"
FORMAT = "trigpoint-demo/1"

_OWN = (
    "site.toml", "*target.toml", "*.yaml", "truth.json", "*.tum", "network.json", "covariance.npz",
    "checkpoint.bin", "session*.mcap", "session.rrd", "report.html", "*.port", "*.jsonl",
    "log/*.log", "*.part", MARKER,
)  # fmt: skip
"""What a demo leaves behind; no other file is ever touched."""


class DemoRecord(Struct, frozen=True):
    """What was run: world time 0 was at `epoch_ns`, and the session ends `seconds` later."""

    world: str
    seed: int
    target: str
    seconds: float
    epoch_ns: int
    processes: dict[str, int] = {}
    restarts: dict[str, int] = {}
    counts: dict[str, dict[str, int]] = {}
    format: str = FORMAT
    protocol: str = "trigpoint"


class DemoFolder:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.site, self.truth, self.log = path / "site.toml", path / "truth.json", path / "log"
        self.session, self.review = path / "session.mcap", path / "session.rrd"
        self.report = path / "report.html"

    @property
    def sessions(self) -> list[Path]:
        """The recordings, in order; more than one where the recorder was started again."""
        return sorted(self.path.glob("session*.mcap"), key=lambda path: (len(path.name), path.name))

    def port(self, robot: str) -> Path:
        """The link to the simulated firmware's line."""
        return self.path / robot_port(robot)

    def journal(self, robot: str) -> Path:
        """What the robot itself believed."""
        return self.path / f"{robot}.jsonl"

    def claim(self) -> None:
        """Make the folder ready for a run; an earlier demo's files are deleted.

        Raises InputError where something else lies there, OperationError where a demo still runs.
        """
        if self.path.exists() and any(self.path.iterdir()):
            self._check_earlier()
            for pattern in _OWN:
                for path in self.path.glob(pattern):
                    path.unlink()
        try:
            self.log.mkdir(parents=True, exist_ok=True)
        except OSError as reason:
            raise OperationError(
                f"{self.path}: the folder cannot be made ({reason.strerror}); give another --out"
            ) from None

    def _check_earlier(self) -> None:
        if not (self.path / MARKER).exists():
            raise InputError(
                f"{self.path}: the folder has other files than an earlier demo's; give another "
                "--out"
            )
        running = [
            f"{name} (process {number})"
            for name, number in self.read().processes.items()
            if _is_ours(number, self.path)
        ]
        if running:
            raise OperationError(
                f"{self.path}: a demo still runs here: {', '.join(running)}; end it, or give "
                "another --out"
            )

    def prepare(self, world: World, record: DemoRecord, locator: str) -> None:
        """Write the site, its targets and lenses, and the truth; raises OperationError."""
        with writing(self.path):
            write_site(
                world,
                self.path,
                epoch_ns=record.epoch_ns,
                bus=BusConfig(connect=(locator,)),
                recordings=".",
                pictures=True,
                protocol=record.protocol,
            )
        self.write(record)

    def write(self, record: DemoRecord) -> None:
        data = msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"
        with writing(self.path):
            replace_file(self.path / MARKER, data)

    def read(self) -> DemoRecord:
        """What was run; raise InputError where the file is not a demo's."""
        path = self.path / MARKER
        text = read_text(path, "record of a demo", InputError)
        try:
            record = msgspec.json.decode(text, type=DemoRecord)
        except msgspec.DecodeError as reason:
            raise InputError(
                f"{path}: no record of a demo ({reason}); give another --out"
            ) from None
        if record.format != FORMAT:
            raise InputError(f"{path}: of another version ({record.format}); give another --out")
        return record


def _is_ours(number: int, folder: Path) -> bool:
    """Whether a process lives and was started for this folder (the number may be another's now)."""
    if number == os.getpid():
        return False
    try:
        words = Path(f"/proc/{number}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    mine = os.fsencode(folder.resolve())
    return any(word == mine or word.startswith(mine + b"/") for word in words)
