"""The commands `target check` and `target draw`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from trigpoint.errors import OperationError, TargetError
from trigpoint.target import load_target

from .target_check import check_target

File = Annotated[Path, typer.Argument(help="The target file.")]


def check(
    file: File,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say what is wrong with a target file, and how the target behaves."""
    target = load_target(file)
    findings = check_target(target)
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
        typer.echo(f"target «{target.name}» is sound: {len(target.faces)} faces, {corners} corners")


def draw(
    file: File,
    out: Annotated[
        Path | None, typer.Option(help="The PDF to write; by default beside the target file.")
    ] = None,
) -> None:
    """Write a target as a PDF to print at true scale: one page a face, and a bar to measure."""
    from .target_drawing import draw_target

    target = load_target(file)
    findings = check_target(target)
    if findings.problems:
        raise TargetError(f"{file}: {findings.problems[0]}")
    path = out or file.with_suffix(".pdf")
    try:
        sheets = draw_target(target, path)
    except OSError as reason:
        raise OperationError(
            f"{path} cannot be written ({reason.strerror}); choose another --out"
        ) from None
    for face, sheet in zip(target.faces, sheets, strict=True):
        typer.echo(f"face {face.id}: {sheet.name}")
    typer.echo(f"{path}: {len(sheets)} pages; print at 100 % and measure the bar on each")
