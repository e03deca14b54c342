"""Boards that people may mean when they describe another one, and what they should write."""

from collections.abc import Container, Iterator, Sequence
from itertools import product, zip_longest

import cv2
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import TargetError
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import dictionary_of
from trigpoint.site.target import Face, Numbering, Pattern

# What says where markers are, not which.
_PLACES = {"columns", "rows", "legacy", "numbering"}


class Other(Struct, frozen=True):
    """A board that may be meant by a look. `change`: what differs, as the target file has it."""

    look: Appearance
    face: Face
    change: tuple[tuple[str, object], ...]
    is_mirrored: bool = False

    @property
    def reads_as_described(self) -> bool:
        """Whether its markers are those of the look, whatever their places."""
        return not self.is_mirrored and {key for key, _ in self.change} <= _PLACES

    @property
    def remedy(self) -> str:
        """What is seen, and what to write, in one line."""
        written = " and ".join(f"{key} = {_toml(value)}" for key, value in self.change)
        seen = ["mirrored"] * self.is_mirrored + [f"with {written}"] * bool(written)
        steps = ["switch off the mirroring (flip) where they are made"] * self.is_mirrored
        steps += [f"write {written}"] * bool(written)
        return (
            f"{self.look.words}: the pictures show this board {' and '.join(seen)}, so it is not "
            f"used; {', and '.join(steps)}"
        )


Others = tuple[Other, ...]
"""Those of one look that one reading of the markers tells apart, the simplest change first: they
differ by where which marker is."""


def others(looks: Sequence[Appearance]) -> Iterator[Others]:
    """The likeliest of every look first; only boards that can be, and that no target has."""
    known = {look.face.appearance for look in looks}
    for alike in zip_longest(*(_of(look, known) for look in looks)):
        yield from filter(None, alike)


def _of(look: Appearance, known: Container[object]) -> Iterator[Others]:
    """What people get wrong comes together: a board that is described after another one."""
    alike: list[tuple[int, Others]] = []
    for is_mirrored, read in product((False, True), _readings(look.face)):
        changes = [read | placed for placed in _places(look.face)]
        faces = [(_changed(look.face, change), change) for change in changes]
        found = tuple(
            Other(look, face, tuple(change.items()), is_mirrored)
            for face, change in faces
            if face and (face.appearance not in known or (is_mirrored and not change))
        )
        if found:
            alike.append((len(read) + is_mirrored, found))
    for _, found in sorted(alike, key=lambda one: one[0]):
        yield found


def _places(face: Face) -> tuple[dict[str, object], ...]:
    """Changes that leave every marker as it is, and have it elsewhere; none first."""
    exchanged: dict[str, object] = {"columns": face.rows, "rows": face.columns}
    if face.pattern is Pattern.CHARUCO:
        other: dict[str, object] = {"legacy": not face.legacy}
    else:
        kalibr = face.numbering is Numbering.KALIBR
        other = {"numbering": (Numbering.TOP_LEFT if kalibr else Numbering.KALIBR).value}
    return {}, other, exchanged, exchanged | other


def _readings(face: Face) -> Iterator[dict[str, object]]:
    """Changes of what the markers are; none first."""
    other: dict[str, object] = {"border_bits": 3 - face.border_bits}
    if face.pattern is Pattern.CHARUCO:
        other = {"inverted": not face.inverted}
    for printed, dictionary in product(({}, other), ({}, *_other_dictionaries(face))):
        yield dictionary | printed


def _changed(face: Face, change: dict[str, object]) -> Face | None:
    """The face changed; None where its dictionary cannot hold it, or it cannot be."""
    typed = {
        key: Numbering(value) if key == "numbering" else value for key, value in change.items()
    }
    changed = replace(face, **typed)
    try:
        dictionary_of(changed)
    except TargetError:
        return None
    return changed if changed.border_bits >= 1 else None


def _other_dictionaries(face: Face) -> Iterator[dict[str, object]]:
    """One of each other kind: as large as the face's, else the largest, since the smaller ones of a
    kind are the first of it."""
    mine = (face.dictionary or "").upper()
    kinds: dict[str, list[str]] = {}
    for name in sorted(dir(cv2.aruco)):
        if name.startswith("DICT_"):
            kinds.setdefault(_kind(name), []).append(name)
    size = mine.rpartition("_")[2]
    for kind, names in kinds.items():
        if kind != _kind(mine):
            same = [name for name in names if name == f"{kind}_{size}"]
            yield {"dictionary": (same or sorted(names, key=lambda n: (len(n), n)))[-1]}


def _kind(name: str) -> str:
    """«DICT_4X4» of DICT_4X4_50; names of other kinds whole, in capitals."""
    upper = name.upper()
    return upper.rpartition("_")[0] if upper[5:6].isdigit() else upper


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, int) else f'"{value}"'
