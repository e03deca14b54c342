"""The commands `target check`, `target draw` and `target import`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError, TargetError, writing
from trigpoint.base.words import counted
from trigpoint.site.target import load_target

from .check import check_target

File = Annotated[Path, typer.Argument(help="The target file.")]


def check(
    file: File,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Draw it into this picture, not in the terminal.")
    ] = None,
) -> None:
    """Say what is wrong with a target file, and how the target behaves; draw what it describes."""
    from .board_drawing import terminal_drawing, write_drawings

    target = load_target(file)
    findings = check_target(target)
    is_drawable = not findings.problems
    if is_drawable and picture is not None:
        for drawn in write_drawings(target, picture):
            typer.echo(f"wrote {drawn}", err=as_json)
    elif is_drawable and not as_json:
        for face in target.faces:
            typer.echo(terminal_drawing(face))
    if as_json:
        result = {"target": target.name, "problems": findings.problems, "notes": findings.notes}
        typer.echo(json.dumps(result, ensure_ascii=False))
    else:
        for note in findings.notes:
            typer.echo(f"note: {note}")
        for problem in findings.problems:
            typer.echo(f"wrong: {problem}")
    if findings.problems:
        raise TargetError(f"{file}: {len(findings.problems)} to mend: {findings.problems[0]}")
    if not as_json:
        corners = sum(face.corner_count for face in target.faces)
        faces = counted(len(target.faces), "face")
        typer.echo(f"target «{target.name}» is sound: {faces}, {corners} corners")


def draw(
    file: File,
    out: Annotated[
        Path | None, typer.Option(help="The PDF to write; by default beside the target file.")
    ] = None,
) -> None:
    """Write a target as a PDF to print at true scale: one page a face, and a bar to measure."""
    from .drawing import draw_target

    target = load_target(file)
    findings = check_target(target)
    if findings.problems:
        raise TargetError(f"{file}: {findings.problems[0]}")
    path = out or file.with_suffix(".pdf")
    with writing(path):
        sheets = draw_target(target, path)
    for face, sheet in zip(target.faces, sheets, strict=True):
        typer.echo(f"face {face.id}: {sheet.name}")
    typer.echo(
        f"{path}: {counted(len(sheets), 'page')}; print at 100 % and measure the bar on each"
    )


def import_kalibr(
    file: Annotated[Path, typer.Argument(help="Kalibr's target.yaml.")],
    out: Annotated[
        Path | None, typer.Option(help="The file to write; by default target.toml beside it.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> None:
    """Write target.toml for a board that Kalibr's YAML describes (aprilgrid, checkerboard)."""
    from .kalibr import imported_text, read_kalibr_target

    target = read_kalibr_target(file)
    path = out or file.with_name("target.toml")
    if path.exists() and not force:
        raise InputError(f"{path} exists already; add --force to replace it, or give --out")
    with writing(path):
        path.write_text(imported_text(target, file.name), encoding="utf-8")
    typer.echo(f"wrote {path}; see what it describes: trigpoint target check {path}")
