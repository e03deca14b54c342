"""The command `target make`: a target file with its poses worked out, and the print."""

from pathlib import Path
from typing import Annotated

import typer

from trigpoint.base.errors import InputError, writing
from trigpoint.base.words import nearest
from trigpoint.site.target import Pattern
from trigpoint.tools.shapes.bodies import Side
from trigpoint.tools.shapes.text import target_text

from .fitting import Wish
from .made import Box, Made, Place, boxed, single, vaned
from .pattern import described
from .sheets import Paper

_HEIGHT_M = 0.4
_FARTHEST_M = 5.0
_HEAD = (
    "Poses are base_from_face: x along a row of corners, y from row to row, z into the board; the",
    "robot's base has x forward, y left, z up. «middle»: of the print, its top up.",
)


def make(
    box: Annotated[
        str | None,
        typer.Option(
            metavar="LxW[xH]",
            help="Boards on the sides of a box: metres along the robot, across it, and upwards "
            "(else the smaller of the two).",
        ),
    ] = None,
    planes: Annotated[
        bool, typer.Option("--planes", help="Six boards on three upright vanes, as in the paper.")
    ] = False,
    board: Annotated[bool, typer.Option("--board", help="A single board.")] = False,
    sides: Annotated[
        str | None,
        typer.Option(
            metavar="SIDES",
            help="Which sides of the robot the boards look to, of front,left,back,right; all for "
            "a box, front for a single board.",
        ),
    ] = None,
    height: Annotated[
        float, typer.Option(help="The boards' middle above the floor, m.")
    ] = _HEIGHT_M,
    at: Annotated[
        str,
        typer.Option(metavar="X,Y", help="The target's middle, forward and left of the base, m."),
    ] = "0,0",
    pattern: Annotated[Pattern, typer.Option(help="What is printed.")] = Pattern.CHARUCO,
    columns: Annotated[
        int | None, typer.Option(help="Squares (aprilgrid: tags) in a row.", min=1, max=100)
    ] = None,
    rows: Annotated[int | None, typer.Option(help="Rows of them.", min=1, max=100)] = None,
    square: Annotated[
        float | None, typer.Option(help="Side of a square (aprilgrid: from tag to tag), m.")
    ] = None,
    sheet: Annotated[Paper, typer.Option(help="The paper.")] = Paper.A4,
    name: Annotated[str | None, typer.Option(help="The target's name.")] = None,
    out: Annotated[
        Path, typer.Option(help="The file to write; the PDF goes beside it.", dir_okay=False)
    ] = Path("target.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> None:
    """Write a target file with every face's pose worked out, and the PDF to print.

    Say what carries the boards: --box, --planes or --board. Squares are as large as paper and box
    allow, unless --columns, --rows or --square say otherwise.
    """
    if not 0 <= height <= _FARTHEST_M:
        raise InputError(f"--height is {height:g}; write metres above the floor, like 0.40")
    pdf = out.with_suffix(".pdf")
    for path in (out, pdf):
        if path.exists() and not force:
            raise InputError(f"{path} exists already; add --force to replace it, or give --out")
    made = _made(
        _shape(box, planes=planes, board=board),
        _sides(sides, planes=planes),
        Place(height, _point(at)),
        Wish(pattern, columns, rows, square),
        sheet,
        name=name,
    )
    _write(made, out, pdf)


def _shape(box: str | None, *, planes: bool, board: bool) -> Box | str:
    """A box, «planes» or «board»; raises InputError unless exactly one is said."""
    said = [name for name, is_said in (("planes", planes), ("board", board)) if is_said]
    shapes = [Box.parse(box) if box is not None else None, *said]
    chosen = [shape for shape in shapes if shape is not None]
    if len(chosen) != 1:
        raise InputError(
            "say what carries the boards, one of: --box 0.30x0.30 (metres along and across the "
            "robot), --planes (three vanes), --board (a single one)"
        )
    return chosen[0]


def _made(
    shape: Box | str,
    sides: list[Side] | None,
    place: Place,
    wish: Wish,
    paper: Paper,
    *,
    name: str | None,
) -> Made:
    if isinstance(shape, Box):
        return boxed(name or "box", shape, sides or list(Side), place, wish, paper)
    if shape == "planes":
        return vaned(name or "three-plane", place, wish, paper)
    if sides is not None and len(sides) != 1:
        raise InputError("a single board looks to one side; give --sides one of them, or --box")
    [side] = sides or [Side.FRONT]
    return single(name or "board", side, place, wish, paper)


def _sides(text: str | None, *, planes: bool) -> list[Side] | None:
    """Sides in the order given, each once; None where none are said."""
    if text is None:
        return None
    if planes:
        raise InputError("--sides is for a box or a single board; leave it out with --planes")
    found = []
    for word in dict.fromkeys(text.split(",")):
        if word not in list(Side):
            raise InputError(
                f"--sides has «{word}»{nearest(word, list(Side))} (front,left,back,right)"
            )
        found.append(Side(word))
    return found


def _point(text: str) -> tuple[float, float]:
    """«0.1,-0.05»; raises InputError."""
    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        x, y = float("nan"), float("nan")
    if not max(abs(x), abs(y)) <= _FARTHEST_M:
        raise InputError(f"--at is «{text}»; write metres forward and to the left, like 0.10,-0.05")
    return x, y


def _write(made: Made, path: Path, pdf: Path) -> None:
    """Write file and PDF, and say what is glued where."""
    from .drawing import draw_target

    target = made.target
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(target_text(target, head=_HEAD, remarks=made.remarks), encoding="utf-8")
    with writing(pdf):
        pages = draw_target(target, pdf)
    typer.echo(f"target «{target.name}», {described(target.faces[0])}")
    for face, page in zip(target.faces, pages, strict=True):
        typer.echo(f"  page {face.id + 1}, face {face.id}, {page.name}: {made.remarks[face.id]}")
    typer.echo(f"wrote {path} and {pdf}")
    typer.echo(
        "next: print at 100 %, measure the bar on each page, and glue each page with its arrow up "
        "and the middle of its print where it says"
    )
