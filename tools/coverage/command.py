"""The command `coverage`: how well robots are corrected where, and by which cameras."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError
from trigpoint.base.terminal import Progress

from .candidates import load_candidates
from .files import write_maps
from .summary import gains_text, ranked, summary_json, summary_text
from .work import known_of, maps_of

_MOST_WITHIN_M = 10.0


def main(
    source: Annotated[
        Path,
        typer.Argument(
            help="A network.json, or its folder; or a recorded session, which is calibrated.",
        ),
    ],
    site: Annotated[
        Path | None,
        typer.Option(
            help="The site file, for what robots carry: else the session's own, or the one beside "
            "the network or here."
        ),
    ] = None,
    robot: Annotated[
        list[str], typer.Option(metavar="NAME", help="Only this robot; give several. Else all.")
    ] = [],  # noqa: B006 - typer makes a list of it anew
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for coverage.png and .yaml (map_server), .geojson and .csv.",
            file_okay=False,
        ),
    ] = None,
    add: Annotated[
        Path | None,
        typer.Option(metavar="F", help="Places for one more camera: which of them helps most."),
    ] = None,
    within: Annotated[
        float, typer.Option(help="By which accuracy, m, places for a camera are ranked.")
    ] = 0.05,
    driven: Annotated[
        bool,
        typer.Option("--driven", help="Only the floor within half a metre of where robots drove."),
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead.")] = False,
) -> None:
    """How well robots are corrected where, and what each camera's failure costs.

    For each decimetre of the floor, eight headings and each robot's target: the radius within which
    95 % of the errors of a position lie that one picture by every camera that sees the robot gives,
    by the network's joint covariance. What is said of a cell holds in more than half of the
    headings. Walls are not known: see --driven.
    """
    if not 0 < within <= _MOST_WITHIN_M:
        raise InputError(f"--within {within:g}: must be above 0 and at most {_MOST_WITHIN_M:g} m")
    known = known_of(source, site=site, robots=robot)
    if driven and not len(known.driven):
        raise InputError(f"--driven: no trajectory lies beside {source}; leave it out")
    candidates = load_candidates(add, known.network) if add is not None else []
    with closing(Progress("coverage")) as progress:
        maps, gains = maps_of(known, candidates, driven_only=driven, step=progress.step)
    if not maps[0].is_floor.any():
        raise InputError(f"{source}: no camera would see a robot anywhere; check the targets")
    gains = ranked(gains, within)
    if json:
        typer.echo(summary_json(maps, gains, within))
    else:
        typer.echo(summary_text(maps))
        if gains:
            typer.echo(f"\n{gains_text(gains, within)}")
    if out is not None:
        files = write_maps(out, maps, known.site)
        if not json:
            typer.echo(f"written to {out}: {', '.join(file.name for file in files)}")
