"""The whole site for hours, with faults:

    python -m benchmarks soak [--hours H] [--every S] [--out DIR]

A secured site in three namespaces (server, cameras, robot) runs its real programs: router, fusion,
recorder, page, two cameras' agents, a bridge and a simulated robot. Every so many seconds something
is broken, each kind in turn. What it comes to: memory, file handles and threads of every program,
latencies, losses, and how soon each was back; `soak.json` has all that was seen.

What is accelerated is how often things break, nothing else: hours of memory are not made shorter.
In the first third every kind comes in turn; after that what ends programs is left out, so that each
lives long enough for its memory to say something.
"""

import itertools
import subprocess
import threading
import time
import traceback
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct, field, json
from msgspec.structs import replace
from support.builders import eventually

from benchmarks.network.segments import PORT, Child, Segments, certify
from benchmarks.table import Row
from benchmarks.timing import family, resident_mb
from trigpoint.contract.access import Kind
from trigpoint.site.config import BusConfig, TlsConfig
from trigpoint.tools.parts.output import LogFile
from trigpoint.tools.parts.specs import FUSION, PAGE, firmware, nodes, trigpoint
from trigpoint.tools.parts.supervisor import Part, PartSpec, Supervisor
from trigpoint.tools.simulation.site_files import robot_port, write_site
from trigpoint.tools.simulation.world import World, load_world

from .faults import FAIR, RECORDING, Fault, Faults, SettableClock

_SAMPLE_S = 2.0
_UP_S = 40.0
_LEAST_DISK_MB, _DISK_MB_A_MINUTE = 256, 12
_BACK_MOST_S = 60.0
_CAMERAS = ("c1", "c2")
_ENDING_SHARE = 1 / 3
_SETTLED_S = 600.0
"""Memory is held against what it was after ten minutes of a life, or a third of a shorter one."""
_MEASURES = (
    ("memory", "MB", "resident_mb"),
    ("files", "files", "files"),
    ("threads", "threads", "threads"),
)
_row = partial(Row, "soak")


class Sample(Struct):
    """One program at a moment: seconds since the start, resident memory, open files, threads."""

    t_s: float
    program: str
    process: int
    resident_mb: float
    files: int
    threads: int


class Break(Struct):
    """Something that was broken; `back_s`: from when it was mended until the key came again."""

    t_s: float
    kind: str
    key: str
    back_s: float = float("nan")


class Record(Struct):
    """All that the run wrote down."""

    seconds: float
    samples: list[Sample] = field(default_factory=list)
    breaks: list[Break] = field(default_factory=list)
    heard: list[dict] = field(default_factory=list)


def sample_of(name: str, part: Part, t_s: float) -> Sample | None:
    """A program as it is; its helpers' memory counts as its own. None where it is being killed."""
    own = Path(f"/proc/{part.number}")
    try:
        resident = sum(map(resident_mb, family(part.number)))
        files, threads = (len(list((own / what).iterdir())) for what in ("fd", "task"))
    except OSError:
        return None
    return Sample(t_s, name, part.number, resident, files, threads)


class Soak:
    """A site that runs, what is done to it, and what is seen."""

    def __init__(self, folder: Path, stack: ExitStack, seconds: float) -> None:
        self.folder, self._stack = folder, stack
        self.record = Record(seconds)
        self._began_s = time.monotonic()
        self._last: dict[str, float] = {}
        self._segments = Segments(("cameras", "robot"), FAIR, stack)
        self._write_sites(load_world("lab", seed=1))
        self._disk = self._small_disk()
        self._clock = SettableClock(folder)
        self.programs = self._started()
        self._faults = Faults(self.programs, self._segments, self._clock, self._disk).each()
        self._start_watch()

    @property
    def _disk_mb(self) -> int:
        """Enough for the recording: about 100 kB a second, and as much for what is broken."""
        return max(_LEAST_DISK_MB, round(_DISK_MB_A_MINUTE * self.record.seconds / 60))

    def _small_disk(self) -> Path:
        """A file system of its own for what the site writes, so that it can be full."""
        disk = self.folder / "session"
        disk.mkdir()
        words = ["mount", "-t", "tmpfs", "-o", f"size={self._disk_mb}m", "soak", str(disk)]
        subprocess.run(words, check=True, timeout=10)
        self._stack.callback(subprocess.run, ["umount", str(disk)], check=True, timeout=10)
        return disk

    def _write_sites(self, world: World) -> None:
        for name in list(world.cameras):
            if name not in _CAMERAS:
                del world.cameras[name]
        addresses = self._segments.addresses
        nodes = [(Kind.CAMERA, name) for name in _CAMERAS]
        nodes += [(Kind.ROBOT, "r1"), (Kind.FUSION, "fusion"), (Kind.RECORDER, "main")]
        certify(self.folder, (*nodes, (Kind.OPERATOR, "anna")), addresses.values())
        self.epoch_ns = time.time_ns() + 20_000_000_000
        buses = {"router": BusConfig(listen=(f"tls/0.0.0.0:{PORT}",), tls=TlsConfig())}
        for name, address in {"server": "127.0.0.1", **addresses}.items():
            buses[name] = BusConfig(connect=(f"tls/{address}:{PORT}",), tls=TlsConfig())
        for name, bus in buses.items():
            path = write_site(world, self.folder, epoch_ns=self.epoch_ns, bus=bus)
            path.rename(self.folder / f"{name}.toml")

    def _started(self) -> dict[str, Part]:
        def site(name: str) -> str:
            return str(self.folder / f"{name}.toml")

        out = str(self.folder / "session")
        link, journal = self.folder / robot_port("r1"), self.folder / "r1.jsonl"
        of_world = {"world": "lab", "seed": 1, "target": "charuco", "log": journal}
        router = trigpoint("router", "--site", site("router"), "--name", "hall")
        page = trigpoint("board", "--site", site("server"), "--port", "0")
        recorder, fusion = nodes(site("server"), cameras=(), robots=(), agents=1, out=out)
        *_, edge = nodes(site("cameras"), cameras=_CAMERAS, robots=(), agents=1)
        *_, robot = nodes(site("robot"), cameras=(), robots=("r1",), agents=1)
        specs = {
            "router": ("server", PartSpec("router", router, FUSION + 1)),
            "fusion": ("server", fusion),
            "recorder": ("server", recorder),
            "page": ("server", PartSpec("page", page, PAGE)),
            "firmware": ("robot", firmware("r1", epoch_ns=self.epoch_ns, link=link, **of_world)),
            "edge": ("cameras", edge),
            "robot": ("robot", robot),
        }
        spaces = {"server": self._segments.router, **self._segments.spaces}
        inside = []
        for name, (space, spec) in specs.items():
            words = (*(self._clock.preloaded if name == "edge" else ()), *spec.command)
            inside.append(replace(spec, command=tuple(spaces[space].command(*words))))
        parts = Supervisor(inside, lambda name: LogFile.of(name, self.folder), say=print)
        return dict(zip(specs, self._stack.enter_context(parts).parts, strict=True))

    def _start_watch(self) -> None:
        """Hear what the site says, until the stack ends."""
        words = ("benchmarks.endurance.watch", str(self.folder / "server.toml"))
        watch = Child(self._segments.router, self._stack, *words)
        thread = threading.Thread(target=self._hear, args=(watch.output,))
        thread.start()
        self._stack.callback(thread.join)
        self._stack.callback(watch.input.close)

    def _hear(self, lines: Iterable[str]) -> None:
        for text in lines:
            row = json.decode(text)
            row["t"] -= self._began_s
            self._last |= {name: one["last"] for name, one in row["heard"].items()}
            self.record.heard.append(row)

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._began_s

    def run(self, every_s: float) -> None:
        """Break something every so often until the time is over."""
        sampling = threading.Event()
        sampler = threading.Thread(target=self._sample, args=(sampling,))
        sampler.start()
        try:
            self._wait_until_up()
            for fault in self._in_turn():
                time.sleep(every_s)
                if self.now_s > self.record.seconds:
                    break
                self._break(fault)
            time.sleep(max(0.0, self.record.seconds - self.now_s))
        finally:
            sampling.set()
            sampler.join()

    def _in_turn(self) -> Iterator[Fault]:
        """Every kind in turn; from a third of the time on without those that end programs."""
        for fault in itertools.cycle(self._faults):
            is_early = self.now_s < self.record.seconds * _ENDING_SHARE
            if is_early or not fault.ends_program:
                yield fault

    def _sample(self, stopping: threading.Event) -> None:
        while not stopping.wait(_SAMPLE_S):
            found = [sample_of(*item, self.now_s) for item in self.programs.items()]
            self.record.samples += [sample for sample in found if sample is not None]

    def _wait_until_up(self) -> None:
        keys = ("sightings", "odom", "robot_pose")
        if not eventually(lambda: all(self._last.get(key) for key in keys), _UP_S):
            raise RuntimeError(f"the site is not up in {_UP_S:.0f} s; see {self.folder}")

    def _break(self, fault: Fault) -> None:
        broken = Break(self.now_s, fault.kind, fault.key)
        self.record.breaks.append(broken)
        fault.act()
        mended_s, recorded = time.monotonic(), self._recorded()
        while time.monotonic() - mended_s < _BACK_MOST_S:
            time.sleep(0.1)
            if fault.key == RECORDING and self._recorded() > recorded:
                self._last[RECORDING] = time.monotonic()
            if self._last.get(fault.key, 0.0) > mended_s:
                broken.back_s = self._last[fault.key] - mended_s
                break
        back = f"{broken.t_s:6.0f} s  {broken.kind}: {broken.key} back {broken.back_s:.1f} s after"
        print(back, flush=True)

    def _recorded(self) -> int:
        """Bytes of all recordings so far."""
        return sum(path.stat().st_size for path in self._disk.glob("**/*.mcap*"))


def rows_of(record: Record) -> Iterator[Row]:
    """All of it."""
    maps = set(record.heard[-1]["maps"]) if record.heard else set()
    yield _row("maps of fusion from begin to end", "maps", len(maps), 1.0, "one is right")
    yield from _programs(record)
    yield from _mended(record)
    yield from _latencies(record)
    yield from _losses(record)


def _programs(record: Record) -> Iterator[Row]:
    """Of each program's longest life."""
    lives: dict[str, dict[int, list[Sample]]] = defaultdict(lambda: defaultdict(list))
    for sample in record.samples:
        lives[sample.program][sample.process].append(sample)
    for program, each in lives.items():
        life = max(each.values(), key=lambda samples: samples[-1].t_s - samples[0].t_s)
        begin_s, end_s = life[0].t_s, life[-1].t_s
        settled_s, span_s = min(_SETTLED_S, (end_s - begin_s) / 3), (end_s - begin_s) / 10
        from_s = begin_s + settled_s
        early = [one for one in life if from_s <= one.t_s <= from_s + span_s]
        late = [one for one in life if one.t_s >= end_s - span_s]
        what, against = f"{program}, {(end_s - begin_s) / 60:.0f} minutes", "settled"
        for name, unit, measure in _MEASURES:
            settled, last = (
                np.median([getattr(s, measure) for s in part]) for part in (early, late)
            )
            yield _row(f"{what}: {name} at the end", unit, float(last), float(settled), against)


def _mended(record: Record) -> Iterator[Row]:
    back_s: dict[tuple[str, str], list[float]] = defaultdict(list)
    for one in record.breaks:
        back_s[one.kind, one.key].append(one.back_s)
    for (kind, key), found in back_s.items():
        # One that never came back is not a number, and makes the longest none either.
        longest, half = float(np.max(found)), float(np.nanmedian(found))
        against = f"the median of {len(found)}"
        yield _row(f"{kind}, mended: {key} back, longest", "s", longest, half, against)


def _latencies(record: Record) -> Iterator[Row]:
    heard: dict[str, list[float]] = defaultdict(list)
    for row in record.heard:
        for name, one in row["heard"].items():
            heard[name] += one["latencies"]
    for name, seconds in heard.items():
        half_s, most_s = np.percentile(seconds, [50, 99]) if seconds else [np.nan] * 2
        what = f"{name}, stamp to heard, 99 % of {len(seconds)}"
        yield _row(what, "ms", 1e3 * float(most_s), 1e3 * float(half_s), "50 %")


def _losses(record: Record) -> Iterator[Row]:
    """By each node's life."""
    for node, lost in sorted(record.heard[-1]["losses"].items()) if record.heard else ():
        for name, count in lost.items():
            if name != "level":
                what = f"{node}: {name.removesuffix('.lost')}, counted as lost"
                yield _row(what, "messages", count, 0.0, "none")


def main(
    hours: Annotated[float, typer.Option(help="How long.", min=0.02)] = 8.0,
    every: Annotated[float, typer.Option(help="Seconds between faults.", min=5.0)] = 60.0,
    out: Annotated[Path, typer.Option(help="Where to write.")] = Path("out/soak"),
) -> list[Row]:
    """Run the site, break it, and say what was seen."""
    out.mkdir(parents=True)
    with ExitStack() as stack:
        soak = Soak(out.absolute(), stack, 3600 * hours)
        try:
            soak.run(every)
        except (OSError, RuntimeError):  # what was seen until then is said, too
            typer.echo(traceback.format_exc(), err=True)
    (out / "soak.json").write_bytes(json.encode(soak.record))
    return list(rows_of(soak.record))
