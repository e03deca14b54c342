"""`python -m benchmarks [NAME…] [--json FILE]`"""

import time
from pathlib import Path
from typing import Annotated

import typer

from .machine import machine
from .report import write_report
from .table import BENCHMARKS, Row, formatted, is_installed, open_benchmark


def main(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help=f"Of {', '.join(BENCHMARKS)}; all without one."),
    ] = None,
    json: Annotated[Path, typer.Option("--json", help="Where the rows are written.")] = Path(
        "out/benchmarks.json"
    ),
    effort: Annotated[
        float, typer.Option(help="Less than 1 is quicker and rougher.", min=0.01)
    ] = 1.0,
) -> None:
    """Measure Trigpoint against the bare libraries, side by side, in about six minutes."""
    chosen = names or list(BENCHMARKS)
    unknown = [name for name in chosen if name not in BENCHMARKS]
    if unknown:
        raise typer.BadParameter(f"no benchmark «{unknown[0]}»; choose of {', '.join(BENCHMARKS)}")
    missing = [name for name in chosen if not is_installed(name)]
    for name in missing:
        typer.echo(f"{name}: left out; pip install -c constraints.txt -e '.[bench]'", err=True)
    before = machine()
    rows: list[Row] = []
    for name in (name for name in chosen if name not in missing):
        began = time.perf_counter()
        rows += open_benchmark(name)(effort)
        typer.echo(f"{name}: measured in {time.perf_counter() - began:.0f} s", err=True)
    typer.echo("\n".join(formatted(rows)))
    write_report(json, rows, before, effort=effort)
    typer.echo(f"{before.summary}\nwritten to {json}")


if __name__ == "__main__":
    typer.run(main)
