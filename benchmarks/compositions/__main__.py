"""`python -m benchmarks.compositions --out DIR --seeds 1:40 [--kind KIND] [--mismatch]`"""

from pathlib import Path
from typing import Annotated

import typer

from trigpoint.errors import TrigpointError

from .files import write_composition
from .recipe import KINDS
from .session import composed_session

app = typer.Typer(add_completion=False)


@app.command()
def main(
    out: Annotated[Path, typer.Option(help="Where the sessions' folders go.")],
    seeds: Annotated[str, typer.Option(help="FIRST:LAST, both included, or one seed.")] = "1:40",
    kind: Annotated[str, typer.Option(help=f"One of {', '.join(KINDS)}.")] = "everything",
    mismatch: Annotated[bool, typer.Option(help="With what the site file does not know.")] = False,
) -> None:
    """Write drawn sessions with their truth, each to a folder KIND-SEED."""
    if kind not in KINDS:
        raise typer.BadParameter(f"no kind «{kind}»; choose of {', '.join(KINDS)}")
    for seed in _seeds(seeds):
        session = composed_session(kind, seed, mismatch=mismatch)
        try:
            directory = write_composition(session, out)
        except TrigpointError as error:
            typer.echo(str(error), err=True)
            raise typer.Exit(1) from None
        count = sum(len(p.faces) for pictures in session.pictures.values() for p in pictures)
        typer.echo(f"{directory}: {len(session.cameras)} cameras, {count} sightings")


def _seeds(text: str) -> range:
    first, separator, last = text.partition(":")
    if not first.isdigit() or (separator and not last.isdigit()):
        raise typer.BadParameter(f"«{text}» are no seeds; write FIRST:LAST, as in 1:40")
    return range(int(first), int(last if separator else first) + 1)


if __name__ == "__main__":
    app()
