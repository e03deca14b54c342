"""A run's rows, printed and as JSON; and the machine and the libraries, as its numbers depend on
them."""

import json
import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from msgspec import Struct
from msgspec.structs import asdict

from .table import Row, formatted

LIBRARIES = ("eclipse-zenoh", "mcap", "numpy", "opencv-python-headless", "rosbags", "trigpoint")


class Machine(Struct, frozen=True):
    """`load`: processes that wanted to run over the last minute, when the run began."""

    cores: int
    load: float
    architecture: str
    python: str
    libraries: dict[str, str]

    @property
    def summary(self) -> str:
        """One line."""
        busy = "busy with other work" if self.load > 0.3 else "idle otherwise"
        return (
            f"{self.cores} cores, {self.architecture}, Python {self.python}; load {self.load:.1f} "
            f"at the start: {busy}"
        )


def machine() -> Machine:
    """This one, now."""
    return Machine(
        cores=len(os.sched_getaffinity(0)),
        load=os.getloadavg()[0],
        architecture=platform.machine(),
        python=platform.python_version(),
        libraries={name: version(name) for name in LIBRARIES},
    )


def tell(rows: Sequence[Row]) -> None:
    """Print the rows and the machine."""
    print("\n".join(formatted(rows)))
    print(machine().summary, flush=True)


def write_report(path: Path, rows: Sequence[Row], machine: Machine, *, effort: float = 1.0) -> None:
    """Write the rows, each with its ratio, and the machine."""
    report = {
        "effort": effort,
        "machine": asdict(machine),
        "rows": [asdict(row) | {"ratio": row.ratio} for row in rows],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2, default=float) + "\n", encoding="utf-8")
