"""The table of benchmarks: by each name the question that it answers, and what a row of it is."""

from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec

import numpy as np
from msgspec import Struct


class Benchmark(Struct, frozen=True):
    """`place`: «module:object». A short one is `run`, which takes an effort and gives rows; any
    other is a command line, of which each run is one of its own. `needs`: libraries that only
    benchmarks have, by spaces.
    """

    question: str
    place: str
    needs: str = ""

    @property
    def is_installed(self) -> bool:
        """Whether everything that it needs is there."""
        return all(find_spec(library) is not None for library in self.needs.split())

    @property
    def is_short(self) -> bool:
        """Whether it may be measured together with others."""
        return self.place.endswith(":run")

    def open(self) -> Callable[..., "list[Row] | None"]:
        """Its object."""
        module, _, name = self.place.partition(":")
        return getattr(import_module(f".{module}", __package__), name)


BENCHMARKS: dict[str, Benchmark] = {
    "detection": Benchmark(
        "how soon, how often and how well are targets found, beside OpenCV?",
        "pictures.detection:run",
    ),
    "real_boards": Benchmark(
        "the same of real pictures, also beside calib-targets and AprilTag",
        "pictures.real_boards:main",
        "calib_targets apriltag",
    ),
    "world": Benchmark(
        "the same of boards as the world shows them", "pictures.world:run", "skimage"
    ),
    "agent": Benchmark("what does an agent of eight cameras take of a core?", "pictures.agent:run"),
    "messages": Benchmark("what do messages cost beside rosbags?", "network.messages:run"),
    "bus": Benchmark("how late are messages beside bare Zenoh?", "network.bus:run"),
    "recorder": Benchmark("how fast are recordings written and read beside mcap?", "recorder:run"),
    "calibration": Benchmark(
        "what does `calibrate` take, and how does that grow?", "fusion.calibration:run"
    ),
    "gtsam": Benchmark(
        "what does a solution take beside GTSAM?", "fusion.gtsam_comparison:run", "gtsam"
    ),
    "updates": Benchmark("what does an update of live fusion take?", "fusion.load:run"),
    "load": Benchmark(
        "what do updates, memory and checkpoint of live fusion come to, under which load; and what "
        "grows with the age of a map?",
        "fusion.load:main",
    ),
    "study": Benchmark(
        "how near to the bound, how honest is `calibrate`, in every situation and composition?",
        "study.command:app",
    ),
    "restart": Benchmark(
        "how soon does a fusion that is started again correct, and how soon is all solved?",
        "fusion.restart:main",
    ),
    "bounded": Benchmark(
        "how near is a map whose past is summarised to all of it solved at once, and how honest?",
        "fusion.bounded_past:main",
    ),
    "latency": Benchmark("how late is a correction, and where did the time go?", "latency:main"),
    "networks": Benchmark(
        "what do bad networks delay and lose, also for an hour, beside an undisturbed twin?",
        "network.bad_links:main",
    ),
    "soak": Benchmark(
        "does a site hold out hours of faults, and what grows?", "endurance.soak:main"
    ),
    "false_sightings": Benchmark(
        "what is found where nothing is?", "pictures.false_sightings:main"
    ),
    "shown": Benchmark("are stills that are shown to an agent published?", "pictures.agent:main"),
    "nudged": Benchmark(
        "are cameras that were moved noticed, and others not?", "pictures.nudged:main", "skimage"
    ),
    "page": Benchmark(
        "what does the web page of a large site cost, and how late is it?", "network.board:main"
    ),
    "accuracy_map": Benchmark(
        "are robots corrected as well as the map of that says?", "fusion.accuracy_map:main"
    ),
    "arm": Benchmark("does the wheel for aarch64 find the same there, under qemu?", "arm:main"),
    "fuzz": Benchmark("does any input harm the compiled core?", "fuzz.runner:main"),
}


class Row(Struct, frozen=True):
    """One quantity, ours and the other's, in `unit`; `against` says what the other is."""

    benchmark: str
    what: str
    unit: str
    ours: float
    other: float
    against: str
    more_is_better: bool = False

    @property
    def ratio(self) -> float | None:
        """Ours over the other; None where the other is 0."""
        return self.ours / self.other if self.other else None


def lateness_rows(benchmark: str, what: str, late_ms: Sequence[float], goal_ms: float) -> list[Row]:
    """How late messages were, in the middle and nearly all of them."""
    half, most = np.percentile(late_ms, [50, 95]).tolist()
    against = f"the goal; {len(late_ms)} messages"
    return [
        Row(benchmark, f"{what}, p50", "ms", half, goal_ms, against),
        Row(benchmark, f"{what}, p95", "ms", most, goal_ms, against),
    ]


def share_of(count: int, effort: float, *, least: int = 1) -> int:
    """A workload of `count` at an effort."""
    return max(least, round(count * effort))


def formatted(rows: Iterable[Row]) -> list[str]:
    """The rows as lines of a Markdown table that also reads well as plain text."""
    head = ("benchmark", "what", "unit", "ours", "other", "ours / other", "better", "other is")
    return columns([head, *map(_cells, rows)])


def columns(lines: list[tuple[str, ...]]) -> list[str]:
    """A Markdown table of cells, the first line its head."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    rule = tuple("-" * width for width in widths)
    return [
        "| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |"
        for line in (lines[0], rule, *lines[1:])
    ]


def _cells(row: Row) -> tuple[str, ...]:
    ratio = f"{row.ratio:.3g}" if row.ratio is not None else "-"
    numbers = (_number(row.ours), _number(row.other), ratio)
    better = "more" if row.more_is_better else "less"
    return (row.benchmark, row.what, row.unit, *numbers, better, row.against)


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
