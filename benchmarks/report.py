"""A run's rows, printed and as JSON."""

import json
from collections.abc import Sequence
from pathlib import Path

from msgspec.structs import asdict

from .machine import Machine, machine
from .table import Row, formatted


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
