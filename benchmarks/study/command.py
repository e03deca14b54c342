"""`python -m benchmarks study run|report|sessions|write`"""

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.recipe import KINDS
from benchmarks.compositions.session import composed_session
from trigpoint.base.errors import TrigpointError

from .report import line_of, write_compositions, write_situations
from .situations import SITUATIONS
from .store import ESTIMATORS, Store, jobs_of, open_jobs
from .store import run as run_jobs

FOLDER = Path("out/study")
PAGES = Path("docs/background")
_GROUPS = {"situations": list(SITUATIONS), "compositions": list(KINDS)}

app = typer.Typer(add_completion=False, no_args_is_help=True)
_Seeds = Annotated[str, typer.Option(help="How many, or FIRST:LAST, both included.")]
_Folder = Annotated[Path, typer.Option(help="Where the results are kept.")]


@app.callback()
def study() -> None:
    """How the estimators do over simulated sessions: situations, beside the Cramér-Rao bound, and
    drawn compositions of everything at once, as a user would calibrate them."""


@app.command()
def sessions() -> None:
    """List the situations and the kinds of compositions."""
    for name, one in (SITUATIONS | KINDS).items():
        typer.echo(f"{name:<20} {one.title}")


@app.command()
def run(
    names: Annotated[
        list[str] | None, typer.Argument(help="Of «sessions»; or situations, compositions.")
    ] = None,
    seeds: _Seeds = "100",
    estimators: Annotated[str, typer.Option(help="Some of smoother,particle,ekf.")] = "smoother",
    processes: Annotated[int, typer.Option(min=1)] = 2,
    limit: Annotated[float, typer.Option(min=1, help="Seconds of work on a session.")] = 120.0,
    folder: _Folder = FOLDER,
) -> None:
    """Work out the sessions that are not in the folder yet; it may be interrupted at any time."""
    store, chosen = Store(folder), tuple(estimators.split(","))
    if unknown := [name for name in chosen if name not in ESTIMATORS]:
        raise typer.BadParameter(f"no estimator «{unknown[0]}»; choose of {', '.join(ESTIMATORS)}")
    jobs = open_jobs(store, jobs_of(_checked(names or ["situations"]), _range(seeds), chosen))
    typer.echo(f"{len(jobs)} sessions to work out, {processes} at a time", err=True)
    is_bad, found = False, run_jobs(store, jobs, processes=processes, limit_s=limit)
    for count, result in enumerate(found, start=1):
        is_bad |= result.is_bad
        typer.echo(f"{count}/{len(jobs)} {line_of(result)}", err=True)
    if is_bad:
        typer.echo("some sessions have no result or a wrong one; see above", err=True)
        raise typer.Exit(1)


@app.command()
def report(
    folder: _Folder = FOLDER,
    docs: Annotated[Path, typer.Option(help="Where the pages are.")] = PAGES,
) -> None:
    """Put the tables into docs/background/accuracy.md of situations and compositions.md of
    compositions, each where there is something."""
    store, written = Store(folder), list[Path]()
    for names, write_page in ((SITUATIONS, write_situations), (KINDS, write_compositions)):
        found = {name: store.kept(name) for name in names}
        if any(one.estimator == "smoother" for results in found.values() for one in results):
            written.append(write_page(found, docs))
    if not written:
        why = "the smoother worked nothing out yet with these sources; say run"
        typer.echo(f"{folder}: {why}", err=True)
        raise typer.Exit(2)
    typer.echo(f"written: {', '.join(map(str, written))}")


@app.command()
def write(
    kind: Annotated[str, typer.Argument(help="A kind of composition.")],
    out: Annotated[Path, typer.Option(help="Their folders KIND-SEED go here.")],
    seeds: _Seeds = "1:40",
) -> None:
    """Write drawn sessions, as recordings with their site files and their truth."""
    if kind not in KINDS:
        raise typer.BadParameter(f"no kind «{kind}»; choose of {', '.join(KINDS)}")
    for seed in _range(seeds):
        session = composed_session(kind, seed)
        try:
            directory = write_composition(session, out)
        except TrigpointError as error:
            typer.echo(str(error), err=True)
            raise typer.Exit(1) from None
        count = sum(len(p.faces) for pictures in session.pictures.values() for p in pictures)
        typer.echo(f"{directory}: {len(session.cameras)} cameras, {count} sightings")


def _checked(names: list[str]) -> list[str]:
    words = [part for name in names for part in name.split(",")]
    chosen = [name for word in words for name in _GROUPS.get(word, [word])]
    if unknown := [name for name in chosen if name not in SITUATIONS | KINDS]:
        known = ", ".join([*_GROUPS, *SITUATIONS, *KINDS])
        raise typer.BadParameter(f"no situation «{unknown[0]}»; choose of {known}")
    return chosen


def _range(text: str) -> range:
    first, separator, last = text.partition(":")
    if not first.isdigit() or (separator and not last.isdigit()):
        raise typer.BadParameter(f"«{text}» are no seeds; write 40, or FIRST:LAST as in 1:40")
    return range(int(first), int(last) + 1) if separator else range(int(first))
