"""The command `trigpoint up`."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from trigpoint.base.errors import InputError
from trigpoint.metrics.serving import OFF
from trigpoint.site.config import Site, load_site
from trigpoint.site.option import SITE_FILE, SiteFile
from trigpoint.tools.parts.specs import PAGE, nodes, trigpoint
from trigpoint.tools.parts.supervisor import PartSpec

from .run import run_parts
from .selection import Choice, Selection, selected

_SIMULATED = Path("simulated")


def main(
    site: SiteFile = SITE_FILE,
    camera: Annotated[
        list[str] | None, typer.Option(help="Only these cameras; may be given again.")
    ] = None,
    robot: Annotated[
        list[str] | None, typer.Option(help="Only these robots; may be given again.")
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PART", help="Leave out: camera, robot, fusion, recorder or board; again."
        ),
    ] = None,
    simulate_robot: Annotated[
        bool,
        typer.Option(
            "--simulate-robot",
            help="No robot yet: a simulated one in a simulated lab, with six cameras that see it, "
            "beside the cameras of this machine. Needs no site file.",
        ),
    ] = False,
    out: Annotated[
        Path, typer.Option(help="Folder of the simulated site's files.", file_okay=False)
    ] = _SIMULATED,
) -> None:
    """Run every part of the site that belongs to this machine: one log, one stop.

    On a secured site the keys here say what belongs; else devices that are here, and what could run
    anywhere where [bus] connect leads to no other machine. A part that ends is started again; one
    that ends six times, each within a minute of its start, ends all with status 1, one that refuses
    its files with status 2. Ctrl-C stops all in order: agents, bridges, recorder, fusion, each
    within two seconds, or eleven where it still writes; twice: at once.
    """
    cameras, robots, left = camera or [], robot or [], without or []
    if not simulate_robot:
        loaded = load_site(site)
        _run(site, loaded, _selected(loaded, cameras, robots, left))
        return
    if robots:
        raise InputError("--robot is a robot of the site; --simulate-robot runs none of them")
    from .simulated import simulated_site

    real = _real_site(site, cameras)
    own = () if real is None else _selected(real, cameras, [], left).cameras
    made = simulated_site(out, real, own)
    typer.echo(f"the simulated robot drives for {made.seconds:.0f} s and then stands")
    loaded = load_site(made.site)
    _run(made.site, loaded, _selected(loaded, [], [made.robot], left), made.firmware)


def _real_site(file: Path, cameras: list[str]) -> Site | None:
    """The site beside the simulated one; None where none was named and none is here."""
    if file.exists() or file != SITE_FILE:
        return load_site(file)
    if cameras:
        raise InputError(f"there is no {file} that has a camera «{cameras[0]}»; give --site FILE")
    return None


def _selected(site: Site, cameras: list[str], robots: list[str], without: list[str]) -> Selection:
    found = selected(site, Choice.of(site, cameras, robots, without))
    site.check_one_machine(cameras=found.cameras, robots=found.robots)
    return found


def parts_of(site: Site, file: Path, selection: Selection) -> list[PartSpec]:
    """The processes of a selection, the slow ones to start first; cameras share one a core."""
    name = str(file)
    specs = nodes(
        name,
        cameras=selection.cameras,
        robots=selection.robots,
        agents=os.cpu_count() or 1,
    )
    left = {"recorder": not selection.has_recorder, "fusion": not selection.has_fusion}
    specs = _with_metrics(site, [spec for spec in specs if not left.get(spec.name)])
    if selection.has_board:
        specs.append(PartSpec("board", trigpoint("board", "--site", name), PAGE, optional=True))
    return specs


def _with_metrics(site: Site, specs: list[PartSpec]) -> list[PartSpec]:
    """Where the site file has a port for metrics, each part one of its own: that and the next."""
    if site.metrics.listen is None:
        return specs
    host, _, port = site.metrics.listen.rpartition(":")
    ports = [int(port) + number if int(port) else 0 for number in range(len(specs))]
    listens = [f"{host}:{port}" if port < 2**16 else OFF for port in ports]
    return [
        replace(spec, command=(*spec.command, "--metrics", listen))
        for spec, listen in zip(specs, listens, strict=True)
    ]


def _run(file: Path, site: Site, selection: Selection, *more: PartSpec) -> None:
    """Say what runs and what does not, and run it."""
    if selection.is_empty:
        reasons = "; ".join(selection.left_out) or "all of it is left out"
        raise InputError(
            f"{file}: no part of the site belongs to this machine ({reasons}); "
            "see `trigpoint up --help`"
        )
    specs = [*parts_of(site, file, selection), *more]
    typer.echo(f"from {file}: {', '.join(spec.name for spec in specs)}")
    for reason in selection.left_out:
        typer.echo(f"not here: {reason}")
    typer.echo(f"how it goes: trigpoint status --site {file}")
    sys.stdout.flush()
    run_parts(specs, sys.stdout)
