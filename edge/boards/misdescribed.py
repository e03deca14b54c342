"""A checkerboard that the target file describes the wrong way round, or by its inner corners.

Which square is black at the top left says how corners are numbered. A board whose columns and rows
were exchanged, or whose corner squares are white, has all of its corners and not its colours: it is
not found, and whoever wrote the file must be told why. Nothing is guessed: it stays not found.
"""

from collections.abc import Sequence

from msgspec.structs import replace

from trigpoint.edge.registration.appearance import Appearance
from trigpoint.site.target import Face


def other_colours(look: Appearance) -> Appearance | None:
    """A look of the same corners with black and white exchanged; None where a half turn makes them
    the same, so that no description is wrong."""
    face = look.face
    if (face.columns + face.rows) % 2 == 1:
        return None
    exchanged = replace(face, inverted=not face.inverted)
    return Appearance(exchanged, look.target, look.face_id)


def turned(face: Face) -> Face:
    """The same board, described as it is when turned by a quarter."""
    exchanges = face.columns % 2 == 0 and face.rows % 2 == 0
    return replace(
        face, columns=face.rows, rows=face.columns, inverted=face.inverted is not exchanges
    )


def remedy(look: Appearance) -> str:
    """What to write for a board that was seen with black and white exchanged, in one line."""
    face = look.face
    top_left = "black" if face.inverted else "white"
    inverted = f"inverted = {str(not face.inverted).lower()}"
    lines = f"write {inverted}"
    if face.columns % 2 == 0:
        lines = (
            f"write columns = {face.rows} and rows = {face.columns}, as it is when turned by a "
            f"quarter, or {inverted}, unless the print is as the file has it: then the pictures "
            "are mirrored (flip)"
        )
    return (
        f"{look.words}: a checkerboard of {face.columns} × {face.rows} squares is seen, but the "
        f"square at its top left is {top_left} where the target file has it "
        f"{'white' if face.inverted else 'black'}, so it is not used; {lines}"
    )


def unexpected(looks: Sequence[Appearance]) -> dict[Appearance, tuple[Appearance, str]]:
    """Looks of boards that none of `looks` is, but one may be meant by: which, and what to write
    where it is seen."""
    known = {look.face.appearance for look in looks}
    known |= {turned(look.face).appearance for look in looks}
    meant = [(other, look, remedy(look)) for look in looks if (other := other_colours(look))]
    meant += [(one_more(look), look, more_remedy(look)) for look in looks]
    # Whoever miscounts leaves a row out; a board that seems one smaller may be half hidden.
    meant += [
        (larger(look, *more), look, counted_remedy(look, *more))
        for look in looks
        for more in ((1, 0), (0, 1))
        if look.face.columns + more[0] != look.face.rows + more[1]  # which no board may have
    ]
    return {
        other: (look, line) for other, look, line in meant if other.face.appearance not in known
    }


def one_more(look: Appearance) -> Appearance:
    """A look of the board that has as many inner corners as the file gives squares."""
    return larger(look, 1, 1)


def larger(look: Appearance, columns: int, rows: int) -> Appearance:
    """A look of a board with so many more columns and rows."""
    face = look.face
    more = replace(face, columns=face.columns + columns, rows=face.rows + rows)
    return Appearance(more, look.target, look.face_id)


def more_remedy(look: Appearance) -> str:
    """What to write for a board that was described by its inner corners, in one line."""
    columns, rows = look.face.columns, look.face.rows
    return (
        f"{look.words}: these pictures show {columns} × {rows} inner corners, but the target file "
        f"counts squares, so it is not used; write columns = {columns + 1} and rows = {rows + 1}"
    )


def counted_remedy(look: Appearance, more_columns: int, more_rows: int) -> str:
    """What to write for a board of which a column or row was not counted, in one line."""
    face = look.face
    columns, rows = face.columns + more_columns, face.rows + more_rows
    return (
        f"{look.words}: these pictures show {columns} × {rows} squares, but the target file has "
        f"{face.columns} × {face.rows}, so it is not used; write columns = {columns} and "
        f"rows = {rows}"
    )
