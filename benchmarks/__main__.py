"""`python -m benchmarks`: the table; `python -m benchmarks NAME…|all`: measure."""

import sys
import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated

import typer

from .report import machine, tell, write_report
from .table import BENCHMARKS, Row, columns

_FOLDER = Path("out")
sys.path.append(str(Path(__file__).parents[1] / "tests"))  # whose helpers some of them share

_INSTALL = "pip install -c constraints.txt -e '.[bench]'"
_SHORT = [name for name, benchmark in BENCHMARKS.items() if benchmark.is_short]


def measure(
    names: Annotated[
        list[str], typer.Argument(metavar="NAME…", help=f"Of {', '.join(_SHORT)}; or all.")
    ],
    json: Annotated[Path, typer.Option("--json", help="Where the rows are written.")] = (
        _FOLDER / "benchmarks.json"
    ),
    effort: Annotated[
        float, typer.Option(help="Less than 1 is quicker and rougher.", min=0.01)
    ] = 1.0,
) -> None:
    """Measure Trigpoint against the bare libraries, side by side, in about six minutes."""
    chosen = _SHORT if names == ["all"] else names
    if unknown := [name for name in chosen if name not in BENCHMARKS]:
        raise typer.BadParameter(f"no benchmark «{unknown[0]}»; choose of {', '.join(BENCHMARKS)}")
    if long := [name for name in chosen if name not in _SHORT]:
        raise typer.BadParameter(f"{long[0]} takes long, and is measured by itself")
    before, rows = machine(), list[Row]()
    for name in chosen:
        if not BENCHMARKS[name].is_installed:
            typer.echo(f"{name}: left out; {_INSTALL}", err=True)
            continue
        began = time.perf_counter()
        rows += BENCHMARKS[name].open()(effort) or []
        typer.echo(f"{name}: measured in {time.perf_counter() - began:.0f} s", err=True)
    if not rows:
        return
    tell(rows)
    write_report(json, rows, before, effort=effort)
    typer.echo(f"{before.summary} (at the start)\nwritten to {json}")


def main() -> None:
    """The table, a benchmark with a command line of its own, or some that have none."""
    if len(sys.argv) < 2:
        rows = [(name, benchmark.question) for name, benchmark in BENCHMARKS.items()]
        print("\n".join(columns([("name", "question"), *rows])))
        return
    name, *words = sys.argv[1:]
    if name not in BENCHMARKS or name in _SHORT:
        _run(measure, sys.argv[1:], "python -m benchmarks")
    elif not BENCHMARKS[name].is_installed:
        sys.exit(f"{name}: {_INSTALL}")
    else:
        own, program = BENCHMARKS[name].open(), f"python -m benchmarks {name}"
        if isinstance(own, typer.Typer):
            own(words, prog_name=program)
        else:
            _run(_told(name, own), words, program)


def _told(name: str, command: Callable[..., list[Row] | None]) -> Callable[..., None]:
    """A benchmark's own command, of which the rows that it gives are printed and written."""

    @wraps(command)
    def run(*arguments: object, **options: object) -> None:
        before = machine()
        rows = command(*arguments, **options)
        if rows:
            tell(rows)
            write_report(_FOLDER / f"{name}.json", rows, before)

    return run


def _run(command: Callable[..., None], words: list[str], program: str) -> None:
    app = typer.Typer(add_completion=False)
    app.command()(command)
    app(words, prog_name=program)


if __name__ == "__main__":
    main()
