"""A secured site over bad networks: cameras and robots in segments of their own, a router between.

    camera ──(link)── router ──(link)── robot, viewer
                         └───(link)── fusion

`run(scenario)` makes the namespaces, runs the real router and nodes with certificates, does to the
links what the scenario says, and returns what came of it.

    python -m benchmarks networks [NAME…]
    python -m benchmarks networks --minutes 60
    python -m benchmarks networks --minutes 10 --every 24

With minutes two sites run at the same time, so that whatever else the machine does delays both. On
one each link loses 5 % of the packets, and every three minutes the router is killed and is away for
three seconds (the first time once every cache is full); the other has neither, and is the measure.
Of the nodes it is said how memory and threads grew.
"""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer
from msgspec import Struct, field
from msgspec.structs import replace

from benchmarks.table import Row
from benchmarks.timing import resident_mb
from trigpoint.contract.access import Kind

from .impairment import Impairment
from .node import Came
from .segments import PORT, Child, Segments, certify

_row = partial(Row, "networks")
_SETTLE_S = 1.0
"""After all are connected: until each has learnt of the others' subscriptions."""
_SEGMENTS = ("camera", "robot", "fusion")
_PEOPLE = ((Kind.CAMERA, "c1"), (Kind.ROBOT, "r1"), (Kind.FUSION, "fusion"), (Kind.VIEWER, "bob"))
_EVERY_S, _DEAD_S, _FULL_S = 180.0, 3.0, 120.0
_LAST_S = 30.0
"""From the router's last return to the end: who says nothing more is not asked for what it said."""
_LINGER_S = 25.0
"""Longer than the cache of odometry: what comes at all has come."""
SITE = """\
site = "lab"
target = "target.toml"
[cameras.c1]
source = "sim://c1"
[robots.r1]
port = "loop://"
"""


class Key(Struct, frozen=True):
    """What came of one key's messages. `rows`: number, when it was put and when it came, ns of the
    monotonic clock; `counted`: how many its subscriber was told to be lost."""

    sent: int
    rows: list[Came]
    counted: int

    @property
    def numbers(self) -> list[int]:
        """In the order in which they came."""
        return [number for number, _, _ in self.rows]

    @property
    def lost(self) -> int:
        """How many never came."""
        return self.sent - len(set(self.numbers))

    @property
    def twice(self) -> int:
        return len(self.rows) - len(set(self.numbers))

    @property
    def uncounted(self) -> int:
        """Lost without the subscriber having been told."""
        return max(0, self.lost - self.counted)

    @property
    def last(self) -> int:
        """The latest message that came, -1 where none did."""
        return max(self.numbers, default=-1)

    def quantile_s(self, share: float) -> float:
        """Of the latencies from put to the subscriber's queue."""
        if not self.rows:
            return float("nan")
        return float(np.quantile([came - put for _, put, came in self.rows], share)) / 1e9

    def longest_gap_s(self) -> float:
        """The longest time in which nothing came."""
        return max((b - a for (*_, a), (*_, b) in pairwise(self.rows)), default=0) / 1e9

    def back_s(self, mended_s: float) -> float:
        """From when something was mended (monotonic clock) to the next message; inf: never."""
        later = (came / 1e9 for *_, came in self.rows if came / 1e9 > mended_s)
        return min(later, default=float("inf")) - mended_s


class Site:
    """A running site; `action`s get it while it runs."""

    def __init__(self, folder: Path, scenario: "Scenario", stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self._protocols = scenario.protocols
        self._segments = Segments(_SEGMENTS, scenario.impairment, stack)
        self.links = self._segments.links
        self._write(scenario.picture_rate)
        self._router: subprocess.Popen[str] | None = None
        self.nodes: dict[str, Child] = {}

    def _write(self, rate: float) -> None:
        addresses = self._segments.addresses
        certify(self._folder, _PEOPLE, addresses.values())
        text = f"{SITE}[bus]\nlisten = {self._endpoints('0.0.0.0')}\n[bus.tls]\n"
        (self._folder / "router.toml").write_text(f"{text}[router]\npicture_rate = {rate}\n")
        for name, address in addresses.items():
            text = f"{SITE}[bus]\nconnect = {self._endpoints(address)}\n[bus.tls]\n"
            (self._folder / f"{name}.toml").write_text(text)

    def _endpoints(self, host: str) -> str:
        """One for each protocol, as site.toml has them."""
        return json.dumps([f"{protocol}/{host}:{PORT}" for protocol in self._protocols])

    def start_router(self) -> None:
        words = [sys.executable, "-m", "trigpoint", "router"]
        words += ["--site", str(self._folder / "router.toml"), "--name", "hall"]
        self._router = subprocess.Popen(
            self._segments.router.command(*words), text=True, stderr=subprocess.DEVNULL
        )

    def kill_router(self) -> None:
        """End it as a power cut does."""
        if self._router is not None:
            self._router.kill()
            self._router.wait()
            self._router = None

    def node(self, role: str, seconds: float, linger_s: float) -> Child:
        segment = "robot" if role == "viewer" else role  # where pictures meet corrections
        words = [role, str(self._folder / f"{segment}.toml"), str(seconds), str(linger_s)]
        space = self._segments.spaces[segment]
        node = self.nodes[role] = Child(space, self._stack, "benchmarks.network.node", *words)
        return node

    def sizes(self) -> dict[str, tuple[float, int]]:
        """Of each node: resident memory in MB, and threads."""
        return {
            role: (resident_mb(pid), len(list(Path(f"/proc/{pid}/task").iterdir())))
            for role, node in self.nodes.items()
            for pid in [node.process.pid]
        }


class Scenario(Struct, frozen=True):
    """What is done: `action` runs beside the nodes, with the site."""

    impairment: Impairment
    seconds: float = 10.0
    roles: tuple[str, ...] = ("camera", "robot", "fusion")
    action: Callable[[Site], object] = bool
    picture_rate: float = 100.0
    late_router: bool = False
    linger_s: float = 60.0
    protocols: tuple[str, ...] = ("tls",)


def run(scenario: Scenario) -> dict[str, Key]:
    """What came of each key; raises NoNamespacesError where none can be made."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        site = Site(folder, scenario, stack)
        stack.callback(site.kill_router)
        if not scenario.late_router:
            site.start_router()
        nodes = [site.node(role, scenario.seconds, scenario.linger_s) for role in scenario.roles]
        acting = threading.Thread(target=scenario.action, args=(site,))
        if scenario.late_router:
            acting.start()
        for node in nodes:
            if node.line() != "ready\n":
                raise RuntimeError("a node of the benchmark did not open its bus")
        time.sleep(_SETTLE_S)
        for node in nodes:
            node.tell("go")
        if not scenario.late_router:
            acting.start()
        sent: dict[str, int] = {}
        for node in nodes:
            sent |= json.loads(node.line())
        acting.join()
        # Fusion first: who left would take along what it keeps, and what still waits for its link.
        answers = []
        for role in sorted(scenario.roles, key=lambda role: role != "fusion"):
            site.nodes[role].tell(json.dumps(sent))
            answers.append(json.loads(site.nodes[role].line()))
    return _keys(sent, answers)


def _keys(sent: dict[str, int], answers: list[dict[str, dict]]) -> dict[str, Key]:
    return {
        name: Key(sent.get(name, 0), rows, answer["missed"][name])
        for answer in answers
        for name, rows in answer["came"].items()
    }


def killing(after_s: float, dead_s: float) -> Callable[[Site], None]:
    """An action: the router's power is cut, and comes back."""

    def act(site: Site) -> None:
        time.sleep(after_s)
        site.kill_router()
        time.sleep(dead_s)
        site.start_router()

    return act


def flapping(times: int, period_s: float = 3.0) -> Callable[[Site], None]:
    """An action: every cable is pulled and put back so many times."""

    def act(site: Site) -> None:
        for _ in range(2 * times):
            time.sleep(period_s)
            for link in site.links.values():
                link.is_up = not link.is_up

    return act


def coming_late(after_s: float) -> Callable[[Site], None]:
    """An action: the router is switched on after the others."""
    return killing(after_s, 0.0)


class Restarts(Struct):
    """An action: the router's power is cut again and again. `returns_s`: when it was back; `sizes`:
    of the nodes just before each cut and at the end."""

    every_s: float
    until_s: float
    returns_s: list[float] = field(default_factory=list)
    sizes: list[dict[str, tuple[float, int]]] = field(default_factory=list)

    def __call__(self, site: Site) -> None:
        first_s = max(self.every_s, _FULL_S)
        time.sleep(first_s - _DEAD_S)
        for _ in range(1 + int((self.until_s - first_s) // self.every_s)):
            self.sizes.append(site.sizes())
            killing(0.0, _DEAD_S)(site)
            self.returns_s.append(time.monotonic())
            time.sleep(self.every_s - _DEAD_S)
        self.sizes.append(site.sizes())


BAD = Impairment(delay_s=0.05, loss=0.05, bits_per_s=20e6)
"""Of each of the two links between any two nodes."""
FAIR = Impairment(delay_s=0.005, bits_per_s=100e6)
DATAGRAMS = ("tls", "quic")
WITH_VIEWER = ("camera", "robot", "fusion", "viewer")

SCENARIOS: dict[str, Scenario] = {
    "undisturbed": Scenario(FAIR, seconds=20),
    "100 ms": Scenario(Impairment(0.05, bits_per_s=20e6), seconds=20),
    "100 ms, pictures": Scenario(Impairment(0.05, bits_per_s=20e6), seconds=20, roles=WITH_VIEWER),
    "100 ms, pictures, router passes 2 a second": Scenario(
        Impairment(0.05, bits_per_s=20e6), seconds=20, roles=WITH_VIEWER, picture_rate=2.0
    ),
    "100 ms, 5 % lost": Scenario(BAD, seconds=30),
    "100 ms, 5 % lost, datagrams": Scenario(BAD, seconds=30, protocols=DATAGRAMS),
    "100 ms, 5 % lost, router killed for 6 s": Scenario(BAD, seconds=30, action=killing(5, 6)),
    "router killed for 30 s": Scenario(FAIR, seconds=55, action=killing(5, 30)),
    "links flap every 3 s": Scenario(FAIR, seconds=30, action=flapping(4)),
    "router comes 5 s late": Scenario(FAIR, seconds=15, action=coming_late(5), late_router=True),
}


def rows_of(what: str, keys: dict[str, Key]) -> Iterator[Row]:
    """What came of each key."""
    for name, key in sorted(keys.items()):
        each = f"{what}, {name}"
        half_ms, most_ms = (1e3 * key.quantile_s(share) for share in (0.5, 0.99))
        yield _row(f"{each}: put to queue, 99 %", "ms", most_ms, half_ms, "50 %")
        yield _row(f"{each}: the longest without", "s", key.longest_gap_s(), 0.0, "none")
        yield _row(f"{each}: lost", "messages", key.lost, key.sent, "sent")
        yield _row(f"{each}: lost, not counted", "messages", key.uncounted, key.lost, "lost")
        yield _row(f"{each}: twice", "messages", key.twice, key.sent, "sent")


def twins(seconds: float, restarts: Restarts) -> Iterator[Row]:
    """What came in the site that is disturbed, beside the one that is not."""
    bad = Scenario(BAD, seconds=seconds, action=restarts, linger_s=_LINGER_S, protocols=DATAGRAMS)
    good = replace(bad, impairment=replace(BAD, loss=0.0), action=bool)
    with ThreadPoolExecutor(2) as threads:
        found, undisturbed = threads.map(run, (bad, good))
    yield from rows_of("disturbed", found)
    yield from rows_of("undisturbed", undisturbed)
    for name, key in sorted(found.items()):
        back_s = [key.back_s(mended_s) for mended_s in restarts.returns_s]
        what, against = f"{name}, back after the router", f"the median of {len(back_s)}"
        yield _row(f"{what}, longest", "s", max(back_s), float(np.median(back_s)), against)
    half = len(restarts.sizes) // 2
    for role in restarts.sizes[0]:
        early, last = restarts.sizes[half][role], restarts.sizes[-1][role]
        against = f"before cut {half + 1}"
        yield _row(f"{role}, memory at the end", "MB", last[0], early[0], against)
        yield _row(f"{role}, threads at the end", "threads", last[1], early[1], against)
    late, other = (1e3 * keys["correction"].quantile_s(0.99) for keys in (found, undisturbed))
    yield _row("corrections, put to queue, 99 %", "ms", late, other, "undisturbed")


def main(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]…", help=f"Of {', '.join(SCENARIOS)}.")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help="Of loss and restarts, beside an undisturbed twin.")
    ] = None,
    every: Annotated[float, typer.Option(help="Seconds from restart to restart.")] = _EVERY_S,
) -> list[Row]:
    """Every scenario or some."""
    if minutes is not None:
        return list(twins(60 * minutes, Restarts(every, 60 * minutes - _LAST_S)))
    return [row for name in names or SCENARIOS for row in rows_of(name, run(SCENARIOS[name]))]
