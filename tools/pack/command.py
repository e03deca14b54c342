"""The command `trigpoint pack`."""

from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError
from trigpoint.base.words import counted
from trigpoint.contract.access import Kind
from trigpoint.site.config import Site, is_loopback, load_site
from trigpoint.site.option import SITE_FILE, SiteFile

from .archive import write_archive
from .contents import PRIVATE, contents
from .machine import Node, Service, site_that_connects, this_machine, wheel_for

_DIST, _CONSTRAINTS = Path("dist"), Path("constraints.txt")


def main(
    kind: Annotated[Service, typer.Argument(help="What the machine is to run.")],
    name: Annotated[
        str, typer.Argument(metavar="ID", help="Its name; a camera's in the site file.")
    ],
    site: SiteFile = SITE_FILE,
    out: Annotated[Path, typer.Option(help="Folder to write to.", file_okay=False)] = Path("packs"),
    wheel: Annotated[
        Path | None, typer.Option(help="The program; if not given, from dist/ here.")
    ] = None,
    machine: Annotated[
        str, typer.Option(help="What `uname -m` says there, like aarch64; if not given, as here.")
    ] = "",
    constraints: Annotated[
        Path, typer.Option(help="The versions that belong to the wheel.")
    ] = _CONSTRAINTS,
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT",
            help="What that machine connects to, like tls/192.168.1.10:7447, in place of what the "
            "site file's [bus] has; it then listens nowhere.",
        ),
    ] = None,
) -> None:
    """Pack what one machine of the site needs: program, files, its keys, a unit, a script.

    Unpack it there, read install.sh, and run it as root. The same input gives the same bytes.
    """
    loaded = load_site(site)
    node = Node.of(loaded, Kind(kind), name)
    if connect is not None:
        loaded = site_that_connects(loaded, connect)
    _check_reaches(loaded, node)
    target = machine or this_machine()
    found = wheel_for(target, wheel, _DIST)
    files = contents(loaded, node, wheel=found, constraints=constraints, machine=target)
    folder = f"{loaded.name}-{node.kind}-{node.name}"
    archive = out / f"{folder}.tar.gz"
    write_archive(archive, folder, files)
    keys = sum(file.mode == PRIVATE and file.path.endswith(".key") for file in files)
    secret = f", {counted(keys, 'private key')} among them: hand it over as a secret" * (keys > 0)
    typer.echo(f"wrote {archive}: {counted(len(files), 'file')}{secret}")
    typer.echo(
        f"there: tar xzf {archive.name} && less {folder}/install.sh && sudo sh {folder}/install.sh"
    )


def _check_reaches(site: Site, node: Node) -> None:
    """Raise InputError where a machine of its own would reach nobody."""
    if node.kind not in (Kind.CAMERA, Kind.ROBOT):
        return
    reaches = site.bus.scouting or any(not is_loopback(one) for one in site.bus.connect)
    if site.bus.listen or not reaches:
        raise InputError(
            f"by this site file the machine of {node.kind} {node.name} "
            f"{'listens itself' if site.bus.listen else 'connects to no other'}; say where the "
            "server is: --connect tls/ADDRESS:7447"
        )
