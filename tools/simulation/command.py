"""The commands `simulate` and `simulate robot`."""

import time
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import writing

from .serial import firmware
from .session import write_session
from .site_files import robot_port, write_site
from .world import load_world
from .world_file import TargetChoice


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


def robot(
    out: Annotated[Path, typer.Option(help="Folder for the site's files.", file_okay=False)],
    world: Annotated[str, typer.Option(help="lab, loop, dance or a world file.")] = "lab",
    seed: Annotated[int, typer.Option(help="Of every random number.", min=0)] = 0,
    target: Annotated[
        TargetChoice | None, typer.Option(help="What the robot carries, if not as in the world.")
    ] = None,
    protocol: Annotated[
        str, typer.Option(help="trigpoint, create2, mavlink or ros_arduino_bridge.")
    ] = "trigpoint",
) -> None:
    """Run a simulated robot on a pseudo-terminal, until it is told to stop.

    The site file that it writes has the robot's port and cameras that see it (sim://), so that
    every other command works as beside real ones; the truth lies beside it. The world begins now,
    and stands still at its end; started again, all begins anew, and so must the cameras' agents.
    """
    epoch_ns = time.time_ns()
    simulated = load_world(world, seed=seed, target=target)
    name = simulated.first_robot
    link = out / robot_port(name)
    with writing(out):
        site = write_site(simulated, out, epoch_ns=epoch_ns, protocol=protocol)
    cameras = " ".join(f"--camera {camera}" for camera in simulated.cameras)
    typer.echo(f"robot {name} drives for {simulated.duration_s:.0f} s; in other terminals:")
    for part, rest in (
        ("edge", cameras),
        ("robot", f"--robot {name}"),
        ("fusion", f"--out {out}"),
        ("record", f"--out {out}"),
        ("board", ""),
        ("view", ""),
    ):
        typer.echo(f"  trigpoint {part} --site {site} {rest}".rstrip())
    firmware.main(world, epoch_ns, name, link, seed=seed, target=target, protocol=protocol)
