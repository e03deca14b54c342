"""The command `trigpoint demo`."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Annotated, Literal

import typer

from trigpoint.base.errors import OperationError, writing
from trigpoint.tools.report.demo.lines import table
from trigpoint.tools.report.demo.page import report_page
from trigpoint.tools.simulation.world import load_world
from trigpoint.tools.simulation.world_file import TargetChoice

from .folder import DemoFolder
from .measured import load_results
from .progress import Progress
from .run import Run, has_display

_WORLD = "lab"
RobotProtocol = Literal["trigpoint", "create2", "mavlink", "ros_arduino_bridge"]
_SHORTEST_S = 10.0
_REVIEW_S = 60.0


def main(
    out: Annotated[
        Path,
        typer.Option(
            help="Folder to write to; an earlier demo's files are replaced.", file_okay=False
        ),
    ] = Path("trigpoint-demo"),
    seed: Annotated[int, typer.Option(help="Of every random number.", min=0)] = 1,
    seconds: Annotated[
        float | None,
        typer.Option(help="Length of the session; the whole drive if not given.", min=_SHORTEST_S),
    ] = None,
    target: Annotated[TargetChoice, typer.Option(help="What the robot carries.")] = "charuco",
    protocol: Annotated[
        RobotProtocol, typer.Option(help="What the simulated robot speaks.")
    ] = "trigpoint",
    no_viewer: Annotated[
        bool, typer.Option("--no-viewer", help="Open no window, also where there is a display.")
    ] = False,
) -> None:
    """The whole system on this machine around a simulated lab; ends with a table of results.

    One process a part: six cameras' agents, the robot's firmware and bridge, fusion, the recorder.
    The exit status is 1 where a camera that the robot came by was missed, is further from the truth
    than five of its sigmas, or where a reliable message was lost.
    """
    began_s = time.monotonic()
    signal.signal(signal.SIGHUP, _end)
    world = load_world(_WORLD, seed=seed, target=target)
    folder = DemoFolder(out)
    progress = Progress(_write, is_terminal=sys.stdout.isatty())
    length_s = seconds or world.duration_s
    has_viewer = has_display() and not no_viewer
    typer.echo(
        f"Trigpoint demo: {len(world.cameras)} cameras, target {target}, seed {seed}, "
        f"{length_s:.0f} s, a robot that speaks {protocol}, into {out}"
    )
    if not has_viewer:
        typer.echo(f"  to watch it: trigpoint board --site {folder.site}")
    try:
        Run(world, folder, length_s, progress, has_viewer, protocol).carry_out()
    except KeyboardInterrupt:
        typer.echo(f"stopped; what there is lies in {out}", err=True)
        raise
    failures = _finish(folder)
    typer.echo(f"\n{time.monotonic() - began_s:.0f} s in all")
    if failures:
        raise OperationError(f"the demo did not do what it should: {'; '.join(failures)}")


def _finish(folder: DemoFolder) -> list[str]:
    """Write what remains to be written, and say it all; return the failures."""
    review = _write_review(folder)
    results = load_results(folder)
    page = report_page(results, folder=str(folder.path))
    with writing(folder.report):
        folder.report.write_text(page, encoding="utf-8")
    typer.echo(f"\n{table(results)}\n")
    if review.wait(_REVIEW_S):
        raise OperationError(f"{folder.review} could not be written; see {folder.log}/review.log")
    _say_files(folder)
    return results.failures


def _write_review(folder: DemoFolder) -> "subprocess.Popen[bytes]":
    """Start writing the session for rerun, beside the other work."""
    command = (sys.executable, "-P", "-m", "trigpoint", "review", str(folder.sessions[0]))
    with (folder.log / "review.log").open("ab") as log:
        return subprocess.Popen(
            (*command, "--save", str(folder.review)),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )


def _say_files(folder: DemoFolder) -> None:
    typer.echo(f"report      {folder.report}")
    typer.echo(f"recording   {', '.join(str(path) for path in folder.sessions)}")
    typer.echo(f"network     {folder.path / 'network.json'}, truth {folder.truth}")
    typer.echo(f"review it   trigpoint review {folder.sessions[0]}   (or: rerun {folder.review})")


def _write(text: str) -> None:
    typer.echo(text, nl=False)


def _end(_number: int, _frame: FrameType | None) -> None:
    """A closed terminal ends the demo as SIGTERM does."""
    raise SystemExit(128 + signal.SIGHUP)
