"""The command `trigpoint simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from .simulation.session import write_session
from .simulation.world import load_world
from .simulation.world_file import TargetChoice


def main(
    world: Annotated[
        str,
        typer.Argument(
            metavar="WORLD", help="loop, dance or drive, or a world file (.toml) of your own."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write to.", file_okay=False)],
    seed: Annotated[int, typer.Option(help="Of every random number.", min=0)] = 0,
    target: Annotated[
        TargetChoice | None,
        typer.Option(help="What the robot carries, if not what the world says."),
    ] = None,
) -> None:
    """Write a recorded session of a simulated lab, with its truth.

    loop: once around the lab, a picture or two a camera and pass. dance: five minutes of turning
    before each camera. drive: the drive of the demo, five pictures a second.
    """
    simulated = load_world(world, seed=seed, target=target)
    counts = write_session(simulated, out)
    sightings = sum(count for key, count in counts.items() if key.endswith("/sightings"))
    odometry = sum(count for key, count in counts.items() if key.endswith("/odom"))
    typer.echo(f"{simulated.duration_s:.1f} s of the world «{world}», seed {seed}:")
    typer.echo(f"  {out / 'session.mcap'}: {odometry} odometry messages, {sightings} pictures")
    typer.echo(f"  {out / 'truth.json'}, {out / 'site.toml'} and the files that they name")
    typer.echo(f"next: trigpoint calibrate {out / 'session.mcap'}")
