"""The command `intrinsics`: one camera's lens from pictures of a target."""

import json
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError, OperationError, writing
from trigpoint.edge.lens.calibration import Calibration, calibrate
from trigpoint.edge.lens.calibration_text import calibration_record, calibration_text
from trigpoint.edge.sources.opencv_log import quieten_opencv
from trigpoint.site.camera_info import write_camera_info
from trigpoint.site.config import load_site
from trigpoint.site.option import site_here
from trigpoint.site.target import Target, load_target

from .detect import check_all
from .intrinsics_page import intrinsics_page
from .intrinsics_search import search


def main(
    pictures: Annotated[
        list[Path], typer.Argument(help="Pictures, folders of them, videos, or bags.")
    ],
    target: Annotated[Path | None, typer.Option(help="The target file.")] = None,
    site: Annotated[Path | None, typer.Option(help="Or the site file that names targets.")] = None,
    topic: Annotated[
        list[str], typer.Option(help="Of a bag (MCAP, rosbag2, ROS 1): the pictures' topic.")
    ] = [],  # noqa: B006 - typer makes a list of it anew
    out: Annotated[
        Path | None, typer.Option(help="Write ROS camera_info YAML here, and a page beside it.")
    ] = None,
    json_text: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Write a lens that the pictures do not determine.")
    ] = False,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Pictures searched at once; by default all cores.")
    ] = None,
) -> None:
    """One camera's intrinsics with sigmas, from pictures of a target held still before it (a
    rolling shutter bends what moves).

    What the pictures do not determine is said, and no file is written.
    """
    targets = _targets(target, site)
    if out is not None and out.suffix not in (".yaml", ".yml"):
        raise InputError(f"{out}: intrinsics are written as YAML; end the name in .yaml")
    quieten_opencv()
    check_all(pictures)
    searched = search(pictures, targets, topics=topic, jobs=jobs)
    for line in (*searched.account, *searched.misdescribed):
        typer.echo(line, err=True)
    found = calibrate(searched.views, searched.size)
    if json_text:
        typer.echo(json.dumps(calibration_record(found)))
    else:
        views = f"{searched.count} pictures, {len(searched.views)} views of the target"
        typer.echo(f"{views}\n{calibration_text(found)}")
    if found.doubts and not force:
        undetermined = "; ".join(str(doubt) for doubt in found.doubts)
        raise OperationError(
            f"the pictures do not determine the lens, so nothing is written (--force does it all "
            f"the same): {undetermined}"
        )
    if out is not None:
        for file in write_lens(out, found, searched.count):
            typer.echo(f"wrote {file}", err=json_text)
    else:
        typer.echo("nothing was written; --out FILE.yaml keeps it", err=True)


def _targets(target: Path | None, site: Path | None) -> list[Target]:
    if target is not None and site is not None:
        raise InputError("two targets are given; give --target FILE, or --site FILE")
    if target is not None:
        return [load_target(target)]
    site = site or site_here()
    if site is None:
        raise InputError("no target is given; give --target FILE, or --site FILE")
    loaded = load_site(site)
    return [load_target(loaded.path(name)) for name in dict.fromkeys(loaded.target_names)]


def write_lens(out: Path, found: Calibration, count: int) -> list[Path]:
    """Write a lens as ROS's YAML, and a page about it and its `count` pictures beside; the files.
    Raises OperationError."""
    page = out.with_suffix(".html")
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        write_camera_info(out, found.camera, out.stem)
        page.write_text(intrinsics_page(found, name=out.stem, pictures=count), encoding="utf-8")
    return [out, page]
