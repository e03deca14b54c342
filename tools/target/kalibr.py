"""Kalibr's target.yaml (aprilgrid, checkerboard) as a target of ours."""

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct, field
from ruamel.yaml import YAML, YAMLError

from trigpoint.base.errors import TargetError, read_text
from trigpoint.site.config.number_types import Count, Positive
from trigpoint.site.target import NOWHERE, Face, Numbering, Pattern, Target
from trigpoint.site.toml_file import checked
from trigpoint.tools.shapes.text import target_text

_EQUAL_SHARE = 1e-6
# Of a tag: one of its ten cells has to fit between two, or they do not stand out.
_LEAST_SPACING = 1 / 10
# Kalibr's only family, with its borders of two cells.
_DICTIONARY = "DICT_APRILTAG_36h11"
_BORDER_BITS = 2
_KIND = "target_type"

_HEADS = {
    Pattern.APRILGRID: (
        "square: from tag to tag; marker: a tag's side with its border; numbering: tags are",
        "counted from the bottom left. translation and quaternion: base_from_face.",
    ),
    Pattern.CHECKERBOARD: (
        "columns and rows are squares; Kalibr counts inner corners, and does not say which are",
        "dark: write inverted = true where the square at the top left is white. translation and",
        "quaternion: base_from_face.",
    ),
}


class _AprilGrid(Struct, rename="camel"):
    kind: Literal["aprilgrid"] = field(name=_KIND)
    tag_cols: Count
    tag_rows: Count
    tag_size: Positive
    tag_spacing: Positive
    code_offset: Annotated[int, Meta(ge=0)] = 0

    def face(self) -> Face:
        if self.tag_spacing < _LEAST_SPACING:
            share = self.tag_spacing / self.tag_size
            raise ValueError(
                f"tagSpacing is {self.tag_spacing:g}, which leaves no room between the tags: it "
                f"is a share of tagSize; if it was written in metres, {share:.3g} is meant"
            )
        return Face(
            0,
            Pattern.APRILGRID,
            self.tag_cols,
            self.tag_rows,
            # Rounded to drop the residue of decimal products.
            float(f"{self.tag_size * (1 + self.tag_spacing):.12g}"),
            *NOWHERE,
            marker=self.tag_size,
            dictionary=_DICTIONARY,
            first_marker=self.code_offset,
            border_bits=_BORDER_BITS,
            numbering=Numbering.KALIBR,
        )


class _Checkerboard(Struct, rename="camel"):
    """Kalibr counts inner corners; the last four are of its own search."""

    kind: Literal["checkerboard"] = field(name=_KIND)
    target_cols: Count
    target_rows: Count
    row_spacing_meters: Positive
    col_spacing_meters: Positive
    show_extraction_video: object = None
    use_adaptive_threshold: object = None
    normalize_image: object = None
    perform_fast_check: object = None

    def face(self) -> Face:
        down, along = self.row_spacing_meters, self.col_spacing_meters
        if abs(down - along) > _EQUAL_SHARE * along:
            raise ValueError(
                f"rowSpacingMeters is {down} and colSpacingMeters {along}; only square squares "
                "can be described: print another board"
            )
        size = self.target_cols + 1, self.target_rows + 1
        return Face(0, Pattern.CHECKERBOARD, *size, along, *NOWHERE)


_BOARDS = {"aprilgrid": _AprilGrid, "checkerboard": _Checkerboard}


def read_kalibr_target(path: Path) -> Target:
    """The target in Kalibr's YAML; raises TargetError that names file and key."""
    text = read_text(path, "Kalibr target file", TargetError)
    try:
        document = YAML(typ="safe", pure=True).load(text)
    except YAMLError as reason:
        line = getattr(getattr(reason, "problem_mark", None), "line", None)
        where = path if line is None else f"{path}:{line + 1}"
        raise TargetError(f"{where}: not valid YAML; mend that line") from None
    if not isinstance(document, dict):
        raise TargetError(f"{path}: no target of Kalibr's (a mapping is needed); give target.yaml")
    kind = str(document.get(_KIND))
    if kind not in _BOARDS:
        known = " or ".join(_BOARDS)
        raise TargetError(f"{path}: {_KIND} is «{kind}»; only {known} can be imported")
    try:
        face = checked(document, _BOARDS[kind], str(path), TargetError).face()
    except ValueError as reason:
        raise TargetError(f"{path}: {reason}") from None
    return Target(path.stem, (face,))


def imported_text(target: Target, source: str) -> str:
    """target.toml of an imported target; `source`: the original file."""
    [face] = target.faces
    return target_text(target, head=(f"From {source}.", *_HEADS[face.pattern]))
