"""`python -m benchmarks.study run|report|show|situations`"""

import os
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from .dance import kept_equal_times
from .measure import Measure, measured
from .runs import ESTIMATORS, Done, jobs_of, open_jobs
from .runs import run as run_jobs
from .situations import SITUATIONS
from .store import Store
from .summary import summary_of

FOLDER = Path("out/study")
PAGES = Path("docs/background")

app = typer.Typer(add_completion=False, no_args_is_help=True)


@app.callback()
def study() -> None:
    """The accuracy of the estimators over simulated sessions of every situation."""


@app.command()
def situations() -> None:
    """List the situations."""
    for name, situation in SITUATIONS.items():
        typer.echo(f"{name:<14} {situation.title}")


@app.command()
def run(
    names: Annotated[list[str] | None, typer.Argument(metavar="[SITUATION]…")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Sessions of each situation.")] = 100,
    estimators: Annotated[str, typer.Option(help="Some of smoother,particle,ekf.")] = "smoother",
    processes: Annotated[int, typer.Option(min=1)] = 2,
    folder: Annotated[Path, typer.Option(help="Where the measures are kept.")] = FOLDER,
) -> None:
    """Work out the sessions that are not in the folder yet; it may be interrupted at any time."""
    # A process of its own for each session leaves nothing for the linear algebra's threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    store = Store(folder)
    chosen = tuple(estimators.split(","))
    if unknown := [name for name in chosen if name not in ESTIMATORS]:
        raise typer.BadParameter(f"no estimator «{unknown[0]}»; choose of {', '.join(ESTIMATORS)}")
    jobs = open_jobs(store, jobs_of(_checked(names), seeds, chosen))
    typer.echo(f"{len(jobs)} sessions to work out, {processes} at a time", err=True)
    failed = 0
    for count, done in enumerate(run_jobs(store, jobs, processes=processes), start=1):
        failed += isinstance(done.result, BaseException)
        typer.echo(f"{count}/{len(jobs)} {_said(done)}", err=True)
    if failed:
        typer.echo(f"{failed} sessions have no result; see above", err=True)
        raise typer.Exit(1)


@app.command()
def report(
    folder: Annotated[Path, typer.Option(help="Where the measures are kept.")] = FOLDER,
    docs: Annotated[Path, typer.Option(help="Where accuracy.md and figures go.")] = PAGES,
    of_any_sources: Annotated[
        bool, typer.Option(help="Take also what other sources than these measured.")
    ] = False,
) -> None:
    """Write docs/background/accuracy.md and its figures from the measures."""
    from .report import write_report  # matplotlib takes a second

    store = Store(folder)
    measures = {n: store.measures(n, of_any_sources=of_any_sources) for n in SITUATIONS}
    if not any(m.estimator == "smoother" for found in measures.values() for m in found):
        why = "the smoother measured nothing yet with these sources; say run"
        typer.echo(f"{folder}: {why}", err=True)
        raise typer.Exit(2)
    typer.echo(f"written: {write_report(measures, kept_equal_times(folder), docs)}")


def _checked(names: list[str] | None) -> list[str]:
    chosen = [part for name in names or [] for part in name.split(",")] or list(SITUATIONS)
    if unknown := [name for name in chosen if name not in SITUATIONS]:
        known = ", ".join(SITUATIONS)
        raise typer.BadParameter(f"no situation «{unknown[0]}»; choose of {known}")
    return chosen


def _said(done: Done) -> str:
    what = f"{done.job.situation} {done.job.seed} {done.job.estimator}"
    if isinstance(done.result, BaseException):
        return f"{what}: {type(done.result).__name__}: {done.result}"
    return f"{what}: {_line(done.result)}"


@app.command()
def show(
    situation: Annotated[str, typer.Argument(help="One of «situations».")],
    seeds: Annotated[int, typer.Option(min=1)] = 5,
    first: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    estimator: Annotated[str, typer.Option()] = "smoother",
) -> None:
    """Measure some sessions of one situation and print each."""
    _checked([situation])
    typer.echo("seed  √(e'P⁻¹e/6n)  own P   distance   bound cm  time s  wrong, undetermined")
    found = []
    for seed in range(first, first + seeds):
        found.append(measured(situation, seed, estimator=estimator))
        typer.echo(_line(found[-1]))
    total = summary_of(found)
    typer.echo(
        f"all   {total.efficiency.value:11.3f} {total.honesty.value:8.3f} "
        f"{100 * total.distance:9.3f} {100 * total.distance_bound:10.3f} {total.seconds:7.2f}  "
        f"sessions: {total.wrong} wrong, {total.undetermined} undetermined"
    )


def _line(m: Measure) -> str:
    notes = [f"{what} {','.join(names)}" for what, names in _notes(m).items() if names]
    return (
        f"{m.seed:<5} {_root(m.efficiency):>11} {_root(m.honesty):>8} "
        f"{100 * m.distance:9.3f} {100 * m.distance_bound:10.3f} {m.seconds:7.2f}  "
        f"{'; '.join([*notes, f'{m.rejected} rejected'])}"
    )


def _root(square: float | None) -> str:
    return f"{np.sqrt(square):.3f}" if square is not None else "-"


def _notes(m: Measure) -> dict[str, list[str]]:
    return {
        "wrong": m.wrong,
        "undetermined": m.undetermined,
        "rightly undetermined": m.left_open,
        "made up": m.made_up,
        "moved": m.earlier,
    }


if __name__ == "__main__":
    app()
