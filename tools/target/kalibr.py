"""Kalibr's target.yaml (aprilgrid, checkerboard) as a target of ours."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML, YAMLError

from trigpoint.base.errors import TargetError, read_text
from trigpoint.site.target import NOWHERE, Face, Numbering, Pattern, Target
from trigpoint.tools.shapes.text import target_text

_EQUAL_SHARE = 1e-6
# Kalibr's only family, with its borders of two cells.
_DICTIONARY = "DICT_APRILTAG_36h11"
_BORDER_BITS = 2

_KEYS = {
    "aprilgrid": ({"tagCols", "tagRows", "tagSize", "tagSpacing"}, {"codeOffset"}),
    "checkerboard": (
        {"targetCols", "targetRows", "rowSpacingMeters", "colSpacingMeters"},
        {"showExtractionVideo", "useAdaptiveThreshold", "normalizeImage", "performFastCheck"},
    ),
}
"""Target type -> the keys that it needs, and those that it may have."""

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


def read_kalibr_target(path: Path) -> Target:
    """The target in Kalibr's YAML; raises TargetError that names file and key."""
    document = _document(path)
    kind = document.get("target_type")
    if kind not in _KEYS:
        known = " or ".join(_KEYS)
        raise TargetError(f"{path}: target_type is «{kind}»; only {known} can be imported")
    _check_keys(document, kind, path)
    make = _aprilgrid if kind == "aprilgrid" else _checkerboard
    try:
        face = make(document, path)
    except ValueError as reason:
        raise TargetError(f"{path}: {reason}") from None
    return Target(path.stem, (face,))


def imported_text(target: Target, source: str) -> str:
    """target.toml of an imported target; `source`: the original file."""
    [face] = target.faces
    return target_text(target, head=(f"From {source}.", *_HEADS[face.pattern]))


def _aprilgrid(document: dict[str, Any], path: Path) -> Face:
    size, spacing = (_length(document, key, path) for key in ("tagSize", "tagSpacing"))
    offset = document.get("codeOffset", 0)
    if not isinstance(offset, int) or offset < 0:
        raise TargetError(f"{path}: codeOffset is «{offset}»; it must be a whole number from 0 on")
    return Face(
        0,
        Pattern.APRILGRID,
        _count(document, "tagCols", path),
        _count(document, "tagRows", path),
        _metres(size * (1 + spacing)),
        *NOWHERE,
        marker=size,
        dictionary=_DICTIONARY,
        first_marker=offset,
        border_bits=_BORDER_BITS,
        numbering=Numbering.KALIBR,
    )


def _checkerboard(document: dict[str, Any], path: Path) -> Face:
    down, along = (_length(document, key, path) for key in ("rowSpacingMeters", "colSpacingMeters"))
    if abs(down - along) > _EQUAL_SHARE * along:
        raise TargetError(
            f"{path}: rowSpacingMeters is {down} and colSpacingMeters {along}; only square squares "
            "can be described: print another board"
        )
    # Kalibr counts inner corners.
    columns, rows = (_count(document, key, path) + 1 for key in ("targetCols", "targetRows"))
    return Face(0, Pattern.CHECKERBOARD, columns, rows, along, *NOWHERE)


def _document(path: Path) -> dict[str, Any]:
    text = read_text(path, "Kalibr target file", TargetError)
    try:
        document = YAML(typ="safe", pure=True).load(text)
    except YAMLError as reason:
        line = getattr(getattr(reason, "problem_mark", None), "line", None)
        where = path if line is None else f"{path}:{line + 1}"
        raise TargetError(f"{where}: not valid YAML; mend that line") from None
    if not isinstance(document, dict):
        raise TargetError(f"{path}: no target of Kalibr's (a mapping is needed); give target.yaml")
    return document


def _check_keys(document: dict[str, Any], kind: str, path: Path) -> None:
    """Refuse unknown keys: they may stand for a board that would be described wrongly."""
    needed, possible = _KEYS[kind]
    for key in sorted(needed - set(document)):
        raise TargetError(f"{path}: the key «{key}» is missing; add it")
    for key in document:
        if key not in needed | possible | {"target_type"}:
            raise TargetError(f"{path}: «{key}» is not a key of Kalibr's {kind}; remove it")


def _count(document: dict[str, Any], key: str, path: Path) -> int:
    return int(_checked(document, key, path, lambda value: isinstance(value, int) and value > 0))


def _length(document: dict[str, Any], key: str, path: Path) -> float:
    def is_length(value: object) -> bool:
        return isinstance(value, int | float) and 0 < value < float("inf")

    return float(_checked(document, key, path, is_length))


def _checked(
    document: dict[str, Any], key: str, path: Path, is_right: Callable[[object], bool]
) -> Any:
    value = document[key]
    if isinstance(value, bool) or not is_right(value):
        raise TargetError(f"{path}: {key} is «{value}»; it must be a number above 0")
    return value


def _metres(value: float) -> float:
    """Metres, rounded to drop the residue of decimal products."""
    return float(f"{value:.12g}")
