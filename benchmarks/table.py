"""The table of benchmarks, and what each of them gives."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

BENCHMARKS: dict[str, str] = {
    "detection": "pictures.detection:run",
    "world": "pictures.world_detection:run",
    "messages": "network.messages:run",
    "bus": "network.bus:run",
    "recorder": "recorder:run",
    "calibration": "fusion.calibration:run",
    "capacity": "pictures.capacity:run",
    "agent": "pictures.agent:run",
    "estimator": "fusion.estimator_speed:run",
    "live": "fusion.live:run",
    "gtsam": "fusion.gtsam_comparison:run",
    "said_rightly": "said_rightly:run",
}

# What is installed for a benchmark alone, with the extra `bench`.
NEEDED: dict[str, str] = {"gtsam": "gtsam", "world": "skimage"}

Benchmark = Callable[[float], "list[Row]"]
"""Takes the effort: 1.0 is the whole measurement, less is quicker and rougher."""


@dataclass(frozen=True, slots=True)
class Row:
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


def open_benchmark(name: str) -> Benchmark:
    """The function of a benchmark."""
    module, _, function = BENCHMARKS[name].partition(":")
    return getattr(import_module(f".{module}", __package__), function)


def is_installed(name: str) -> bool:
    """Whether everything that a benchmark needs is there."""
    return name not in NEEDED or find_spec(NEEDED[name]) is not None


def share_of(count: int, effort: float, *, least: int = 1) -> int:
    """A workload of `count` at an effort."""
    return max(least, round(count * effort))


def formatted(rows: Iterable[Row]) -> list[str]:
    """The rows as lines of a Markdown table that also reads well as plain text."""
    head = ("benchmark", "what", "unit", "ours", "other", "ours / other", "better", "other is")
    lines = [head, *(_cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
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
