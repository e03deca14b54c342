"""The command `calibrate`: the estimator over a recorded session."""

import math
import textwrap
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Literal

import typer

from trigpoint.base.errors import InputError, OperationError, writing
from trigpoint.base.terminal import Progress, table, waiting
from trigpoint.base.words import counted, two_decimals
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.map.building import attached_plan, load_plan
from trigpoint.map.network import ON_ONE_SIGHTING, CameraRecord, encode_network
from trigpoint.tools.networks.building_alignment import Alignment, align, alignment_text
from trigpoint.tools.networks.noise_words import noise_words
from trigpoint.tools.networks.truth import NetworkError, load_truth, network_error

from .report import REPORT, write_report
from .work import Task, fed, task_of

_WIDTH = 100


def main(
    session: Annotated[Path, typer.Argument(help="An .mcap file or a folder with one.")],
    site: Annotated[
        Path | None, typer.Option(help="The site file, if not the one in the session.")
    ] = None,
    network: Annotated[
        Path | None, typer.Option(help="A network.json whose cameras are known beforehand.")
    ] = None,
    estimator: Annotated[
        Literal["smoother", "particle", "ekf"] | None,
        typer.Option(help="The estimator, if not the one in the site file."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to write to; «calibration» beside the session.", file_okay=False),
    ] = None,
    topic: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=TOPIC",
            help="For anybody's bag (MCAP, rosbag2, ROS 1), with --site: which camera's pictures, "
            "or robot's odometry, a topic is, like c1=/front/image_raw. Give several.",
        ),
    ] = [],  # noqa: B006 - typer makes a list of it anew
    json: Annotated[bool, typer.Option("--json", help="Print the network file instead.")] = False,
) -> None:
    """Work out the network of a recorded session, faster than it took.

    Writes network.json, covariance.npz, each robot's trajectory, and report.html with all of it on
    a page. Where a truth.json lies beside the session, the errors against it are stated too.
    """
    beside = session if session.is_dir() else session.parent
    settings = {"fusion.estimator": estimator} if estimator else {}
    task = task_of(session, site=site, network=network, topics=topic, settings=settings)
    inputs, recording = task.inputs, task.recording
    plan = (
        attached_plan(inputs.site, recording.attachments)
        if recording is not None and site is None
        else load_plan(inputs.site)
    )
    folder = out if out is not None else beside / "calibration"
    with writing(folder):  # fail now, not after all the work
        folder.mkdir(parents=True, exist_ok=True)
    pipeline = _worked_out(task)
    results = pipeline.results()
    for text in results.doubts:
        typer.echo(f"note: {text}", err=True)
    results.save(folder)
    error = _error(beside, results)
    alignment = align(inputs.site, plan, results, folder)
    write_report(pipeline, results, error, alignment, session=session, folder=folder)
    if json:
        typer.echo(encode_network(results.network).decode(), nl=False)
    else:
        _print(results, error)
        _say_alignment(alignment)
    if alignment.problem:
        raise InputError(f"{alignment.problem} (the network itself is written to {folder})")
    if not json:
        typer.echo(f"written to {folder}; open {folder / REPORT} in a browser")
    _check_used(results, [*pipeline.arrivals.doubts, *results.doubts])
    if why := pipeline.arrivals.contradicted:
        raise OperationError(f"do not use these cameras: {why}; correct what the notes above say")


def _worked_out(task: Task) -> Pipeline:
    """Do the work, with a word on how far it is and on what was left out."""
    found = task.messages()
    for words in found.unsound():
        typer.echo(f"left out: {words}", err=True)
    with closing(Progress("calibrate", found.count)) as progress:
        pipeline = fed(found, task.inputs, source=task.path, step=progress.step)
    with waiting("calibrate: working out what happened"):
        pipeline.finish()
    for reason, count in sorted(pipeline.messages_left_out.items()):
        typer.echo(f"left out: {count} {reason.replace('_', ' ')}", err=True)
    for text in pipeline.notes:
        typer.echo(f"note: {text}", err=True)
    return pipeline


def _error(folder: Path, results: Results) -> NetworkError | None:
    path = folder / "truth.json"
    if not path.exists():
        return None
    return network_error(results.network, results.covariance, load_truth(path))


def _check_used(results: Results, doubts: Sequence[str]) -> None:
    """Raise OperationError where no camera is located, and what one saw could not be used, or what
    came of robots cannot be right."""
    cameras = results.network.cameras.items()
    unused = [(n, c.undetermined[0]) for n, c in cameras if c.status == "unseen" and c.undetermined]
    if unused and not results.network.located:
        (name, why), *more = unused
        others = f" (and {counted(len(more), 'other camera')} likewise)" if more else ""
        raise OperationError(f"no camera could be located; {name}{others} is unseen: {why}")
    if doubts and not results.network.located:
        raise OperationError("no camera could be located; the notes above say what may be why")


def _say_alignment(alignment: Alignment) -> None:
    if alignment.building is not None:
        typer.echo(alignment_text(alignment.building))


def _row(name: str, camera: CameraRecord, error: NetworkError | None) -> list[str]:
    if camera.status != "located":
        return [name, camera.status]
    turn = math.degrees(camera.rotation_sigma)
    row = [name, camera.status, two_decimals(100 * camera.position_sigma), two_decimals(turn)]
    rms_px = camera.reprojection_rms
    row += [str(camera.sightings), str(camera.rejected), "–" if rms_px is None else f"{rms_px:.2f}"]
    if error and name in error.cameras:
        mine = error.cameras[name]
        row += [two_decimals(100 * mine.position), two_decimals(math.degrees(mine.rotation))]
        row.append(f"{mine.sigmas:.1f}")
    return row


def _print(results: Results, error: NetworkError | None) -> None:
    head = ["camera", "status", "sigma cm", "deg", "sightings", "rejected", "rms px"]
    if error:
        head += ["error cm", "deg", "sigmas"]
    cameras = results.network.cameras.items()
    rows = [_row(name, camera, error) for name, camera in cameras]
    width = max(map(len, rows), default=0)
    filled = [row + [""] * (width - len(row)) for row in rows]
    colours = ["" if camera.status == "located" else "yellow" for _, camera in cameras]
    typer.echo(table(head[:width], filled, left=(0, 1), colours=colours))
    for name, camera in cameras:
        for reason in camera.undetermined:
            if camera.status == "undetermined":
                typer.echo(f"{name} is not determined: {reason}")
            elif results.network.located:  # else the command ends in that
                typer.echo(f"{name} is unseen: {reason}")
        if camera.status == "located" and not camera.confirmed:
            typer.echo(f"{name} {ON_ONE_SIGHTING}")
    if (chi2 := results.network.statistics.chi2_per_dof) is not None:
        words = f"{chi2:.3f}: {noise_words(chi2, results.noise)}"
        typer.echo(textwrap.fill(words, _WIDTH, subsequent_indent="  ", break_on_hyphens=False))
    if error and error.distance is not None:
        typer.echo(f"mean error of the distances between cameras: {100 * error.distance:.2f} cm")
        typer.echo(f"errors against the joint covariance, per degree of freedom: {error.nees:.2f}")
