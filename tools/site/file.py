"""The texts of a site.toml, by `full_site.toml` beside this file, and of a first target.toml."""

from pathlib import Path

from trigpoint.site.target import NOWHERE, Face, Pattern, Target
from trigpoint.site.toml_file import toml_value
from trigpoint.tools.shapes.bodies import Side, box_faces
from trigpoint.tools.shapes.text import target_text

_FULL = Path(__file__).with_name("full_site.toml")
_FIRST_KEYS = {
    "[cameras.c1]": ("source", "width", "height", "rate", "intrinsics", "horizontal_fov"),
    "[robots.r1]": ("port", "baud"),
}
"""What of which tables a first file has."""
_COMMENT_COLUMN = 32


def full_site_text() -> str:
    """Every key with its default and a comment."""
    return _FULL.read_text(encoding="utf-8")


def first_site_text(
    *, source: str | None = None, port: str | None = None, protocol: str | None = None
) -> str:
    """The shortest site file: one camera, one robot, this machine alone. What is known of them goes
    in place of the examples; the protocol is written where it is said."""
    given = {"source": source, "port": port, "protocol": protocol}
    said = {key: value for key, value in given.items() if value is not None}
    head, *tables = (block.splitlines() for block in full_site_text().split("\n\n"))
    blocks = [[line for line in head if not line.startswith("# expect")]]
    for title, *rows in tables:
        if title in _FIRST_KEYS:
            keys = {*_FIRST_KEYS[title], *said}
            kept = [_row(row, said) for row in rows if row.partition(" = ")[0] in keys]
            blocks.append([title, *kept])
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _row(row: str, said: dict[str, str]) -> str:
    """A row of the full file, with what is said in place of its value."""
    key, comment = row.partition(" = ")[0], row.partition("  # ")[2]
    if key not in said:
        return row
    return f"{f'{key} = {toml_value(said[key])}':<{_COMMENT_COLUMN - 2}}  # {comment}"


_TARGET_HEAD = (
    "Three ChArUco faces on a box: ahead, left and right. For your own box, vanes or single board,",
    "with poses and a PDF: trigpoint target make --help",
    "translation and quaternion are base_from_face: x along a row of corners, y from row to row, z",
    "into the board; the robot's base has x forward, y left, z up. Corner 0 is the top left inner",
    "corner of the face seen upright.",
)
_BOARD = Face(0, Pattern.CHARUCO, 5, 7, 0.035, *NOWHERE, marker=0.026, dictionary="DICT_4X4_100")
_SIDES = (Side.FRONT, Side.LEFT, Side.RIGHT)
_BOX_M, _HEIGHT_M = 0.30, 0.40


def first_target_text() -> str:
    """A target of three faces that fit on A4 and that a picture can tell apart."""
    faces = box_faces(_BOARD, _SIDES, length=_BOX_M, width=_BOX_M, height=_HEIGHT_M)
    return target_text(Target("box", faces), head=_TARGET_HEAD, remarks=dict(enumerate(_SIDES)))
