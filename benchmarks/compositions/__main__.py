"""`python -m benchmarks.compositions --out DIR --seeds 1:40 [--kind KIND] [--mismatch]`,
`python -m benchmarks.compositions run|report|kinds`"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import TrigpointError

from .files import write_composition
from .kept import keep, kept
from .recipe import KINDS
from .report import line_of, summary_lines, write_report
from .score import Score, scored
from .session import composed_session

FOLDER = Path("out/compositions")
PAGES = Path("docs/background")
SEEDS_HELP = "FIRST:LAST, both included, or one seed."

app = typer.Typer(add_completion=False)

_Kinds = Annotated[list[str] | None, typer.Argument(metavar="[KIND]…", help="All, if none.")]


@app.callback(invoke_without_command=True)
def write(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option(help="Write sessions; their folders KIND-SEED go here.")
    ] = None,
    seeds: Annotated[str, typer.Option(help=SEEDS_HELP)] = "1:40",
    kind: Annotated[str, typer.Option(help="One of «kinds».")] = "everything",
    mismatch: Annotated[
        bool, typer.Option("--mismatch", help="With what the site file does not know.")
    ] = False,
) -> None:
    """Drawn sessions with their truth, and how `calibrate` does on them."""
    if context.invoked_subcommand is not None:
        return
    if out is None:
        raise typer.BadParameter("say where to write to, as in --out sessions; or run, report")
    _check([kind])
    for seed in _seeds(seeds):
        session = composed_session(kind, seed, mismatch=mismatch)
        try:
            directory = write_composition(session, out)
        except TrigpointError as error:
            typer.echo(str(error), err=True)
            raise typer.Exit(1) from None
        count = sum(len(p.faces) for pictures in session.pictures.values() for p in pictures)
        typer.echo(f"{directory}: {len(session.cameras)} cameras, {count} sightings")


@app.command()
def kinds() -> None:
    """List the kinds of sessions."""
    for name, preset in KINDS.items():
        typer.echo(f"{name:<17} {preset.title}")


@app.command()
def run(
    names: _Kinds = None,
    seeds: Annotated[str, typer.Option(help=SEEDS_HELP)] = "1:40",
    limit: Annotated[float, typer.Option(min=1, help="Processor seconds of a session.")] = 120.0,
    processes: Annotated[int, typer.Option(min=1)] = 2,
    folder: Annotated[Path, typer.Option(help="Where the scores are kept.")] = FOLDER,
) -> None:
    """Calibrate the sessions that are not in the folder yet; it may be interrupted at any time."""
    chosen = _check(names or list(KINDS))
    jobs = [
        (kind, seed)
        for seed in _seeds(seeds)
        for kind in chosen
        if seed not in {score.seed for score in kept(folder, kind)}
    ]
    typer.echo(f"{len(jobs)} sessions to work out, {processes} at a time", err=True)
    for count, score in enumerate(_scored(jobs, limit, processes), start=1):
        keep(folder, score)
        typer.echo(f"{count}/{len(jobs)} {line_of(score)}", err=True)
    wanted = set(_seeds(seeds))
    found = {kind: [s for s in kept(folder, kind) if s.seed in wanted] for kind in chosen}
    typer.echo("\n".join(summary_lines(found)))
    if any(score.is_bad for of_kind in found.values() for score in of_kind):
        raise typer.Exit(1)


@app.command()
def report(
    folder: Annotated[Path, typer.Option(help="Where the scores are kept.")] = FOLDER,
    docs: Annotated[Path, typer.Option(help="Where compositions.md goes.")] = PAGES,
    of_any_sources: Annotated[
        bool, typer.Option("--of-any-sources", help="Take also what other sources scored.")
    ] = False,
) -> None:
    """Write docs/background/compositions.md from the scores."""
    found = {kind: kept(folder, kind, of_any_sources=of_any_sources) for kind in KINDS}
    if not any(found.values()):
        typer.echo(f"{folder}: nothing was scored yet with these sources; say run", err=True)
        raise typer.Exit(2)
    typer.echo(f"written: {write_report(found, docs)}")


def _scored(jobs: list[tuple[str, int]], limit: float, processes: int) -> Iterator[Score]:
    with ThreadPoolExecutor(processes) as pool:
        futures = [pool.submit(scored, kind, seed, limit_s=limit) for kind, seed in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _check(names: list[str]) -> list[str]:
    if unknown := [name for name in names if name not in KINDS]:
        raise typer.BadParameter(f"no kind «{unknown[0]}»; choose of {', '.join(KINDS)}")
    return names


def _seeds(text: str) -> range:
    first, separator, last = text.partition(":")
    if not first.isdigit() or (separator and not last.isdigit()):
        raise typer.BadParameter(f"«{text}» are no seeds; write FIRST:LAST, as in 1:40")
    return range(int(first), int(last if separator else first) + 1)


if __name__ == "__main__":
    app()
