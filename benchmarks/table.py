"""The table of benchmarks: by each name the question that it answers, and what a row of it is."""

from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

import numpy as np
from msgspec import Struct


class Benchmark(Struct, frozen=True):
    """`module`: has `run`, which takes an effort and gives rows; `main`, a command line, where it
    `has_options` or `is_long` (or `app`, of several). `needs`: a library that only benchmarks have.
    """

    question: str
    module: str
    needs: str = ""
    has_options: bool = False
    is_long: bool = False

    @property
    def is_installed(self) -> bool:
        """Whether everything that it needs is there."""
        return not self.needs or find_spec(self.needs) is not None

    def module_opened(self) -> ModuleType:
        """Its module."""
        return import_module(f".{self.module}", __package__)

    def open(self) -> Callable[..., "list[Row] | None"]:
        """`run`; of a long one `main`."""
        module = self.module_opened()
        return module.run if not self.is_long else getattr(module, "app", None) or module.main


BENCHMARKS: dict[str, Benchmark] = {
    "detection": Benchmark(
        "how soon, how often and how well are targets found, beside OpenCV?", "pictures.detection"
    ),
    "real_boards": Benchmark(
        "the same of real pictures, also beside calib-targets and AprilTag",
        "pictures.real_boards",
        "calib_targets",
        is_long=True,
    ),
    "world": Benchmark(
        "the same of boards as the world shows them", "pictures.world_detection", "skimage"
    ),
    "agent": Benchmark("what does an agent of eight cameras take of a core?", "pictures.agent"),
    "messages": Benchmark("what do messages cost beside rosbags?", "network.messages"),
    "bus": Benchmark("how late are messages beside bare Zenoh?", "network.bus"),
    "recorder": Benchmark("how fast are recordings written and read beside mcap?", "recorder"),
    "calibration": Benchmark(
        "what does `calibrate` take, and how does that grow?", "fusion.calibration"
    ),
    "gtsam": Benchmark(
        "what does a solution take beside GTSAM?", "fusion.gtsam_comparison", "gtsam"
    ),
    "study": Benchmark(
        "how near to the bound, how honest is `calibrate`, in every situation and composition?",
        "study.command",
        is_long=True,
    ),
    "load": Benchmark(
        "what do updates, memory and checkpoint of live fusion come to, under which load; and what "
        "grows with the age of a map?",
        "fusion.load",
        has_options=True,
    ),
    "restart": Benchmark(
        "how soon does a fusion that is started again correct, and how soon is all solved?",
        "fusion.restart",
        is_long=True,
    ),
    "bounded": Benchmark(
        "how near is a map whose past is summarised to all of it solved at once, and how honest?",
        "fusion.bounded_past",
        is_long=True,
    ),
    "latency": Benchmark(
        "how late is a correction, and where did the time go?", "latency", is_long=True
    ),
    "networks": Benchmark(
        "what do bad networks delay and lose, also for an hour, beside an undisturbed twin?",
        "network.bad_links",
        is_long=True,
    ),
    "soak": Benchmark(
        "does a site hold out hours of faults, and what grows?", "endurance.soak", is_long=True
    ),
    "false_sightings": Benchmark(
        "what is found where nothing is?", "pictures.false_sightings", is_long=True
    ),
    "shown": Benchmark(
        "are stills that are shown to an agent published?", "pictures.agent", is_long=True
    ),
    "nudged": Benchmark(
        "are cameras that were moved noticed, and others not?", "pictures.nudged", is_long=True
    ),
    "page": Benchmark(
        "what does the web page of a large site cost, and how late is it?",
        "network.board",
        is_long=True,
    ),
    "accuracy_map": Benchmark(
        "are robots corrected as well as the map of that says?", "fusion.accuracy_map", is_long=True
    ),
    "arm": Benchmark(
        "does the wheel for aarch64 find the same there, under qemu?", "arm", is_long=True
    ),
    "fuzz": Benchmark("does any input harm the compiled core?", "fuzz.command", is_long=True),
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
