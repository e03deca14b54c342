"""`python -m benchmarks.study show SITUATION [--seeds N]`"""

from typing import Annotated

import numpy as np
import typer

from .measure import Measure, measured
from .situations import SITUATIONS

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
def show(
    situation: Annotated[str, typer.Argument(help="One of «situations».")],
    seeds: Annotated[int, typer.Option(min=1)] = 5,
    first: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    estimator: Annotated[str, typer.Option()] = "smoother",
) -> None:
    """Measure some sessions of one situation and print each."""
    if situation not in SITUATIONS:
        known = ", ".join(SITUATIONS)
        raise typer.BadParameter(f"no situation «{situation}»; choose of {known}")
    typer.echo("seed  √(e'P⁻¹e/6n)  own P   distance   bound cm  time s  wrong, undetermined")
    found = []
    for seed in range(first, first + seeds):
        found.append(measured(situation, seed, estimator=estimator))
        typer.echo(_line(found[-1]))
    efficiency = np.sqrt(np.mean([m.efficiency for m in found]))
    honesty = np.sqrt(np.mean([m.honesty for m in found]))
    distance = 100 * np.mean([m.distance for m in found])
    bound = 100 * np.mean([m.distance_bound for m in found])
    wrong = sum(len(m.wrong) for m in found)
    typer.echo(
        f"all   {efficiency:11.3f} {honesty:8.3f} {distance:9.3f} {bound:10.3f}"
        f" {np.mean([m.seconds for m in found]):7.2f}  {wrong} wrong"
    )


def _line(m: Measure) -> str:
    notes = [f"{what} {','.join(names)}" for what, names in _notes(m).items() if names]
    return (
        f"{m.seed:<5} {np.sqrt(m.efficiency):11.3f} {np.sqrt(m.honesty):8.3f} "
        f"{100 * m.distance:9.3f} {100 * m.distance_bound:10.3f} {m.seconds:7.2f}  "
        f"{'; '.join([*notes, f'{m.rejected} rejected'])}"
    )


def _notes(m: Measure) -> dict[str, list[str]]:
    return {
        "wrong": m.wrong,
        "undetermined": m.undetermined,
        "made up": m.made_up,
        "moved": m.earlier,
    }


if __name__ == "__main__":
    app()
