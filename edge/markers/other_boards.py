"""Boards that people may mean when they describe another one, and what they should write."""

from collections.abc import Container, Iterator, Sequence
from itertools import zip_longest

import cv2
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import TargetError
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import dictionary_of
from trigpoint.site.target import Face, Numbering, Pattern


class Other(Struct, frozen=True):
    """A board that may be meant by a look. `change`: what differs, as the target file has it, none
    where the picture is mirrored."""

    look: Appearance
    face: Face
    change: tuple[tuple[str, object], ...]

    @property
    def is_mirrored(self) -> bool:
        return not self.change

    @property
    def remedy(self) -> str:
        """What is seen, and what to write, in one line."""
        if self.is_mirrored:
            return (
                f"{self.look.words}: the pictures show it mirrored, so it is not used; switch off "
                "the mirroring (flip) where they are made"
            )
        written = " and ".join(f"{key} = {_toml(value)}" for key, value in self.change)
        return (
            f"{self.look.words}: the pictures show this board with {written}, so it is not used; "
            f"write {written}"
        )


def others(looks: Sequence[Appearance]) -> Iterator[Other]:
    """The likeliest of every look first; only boards that can be, and that no target has."""
    known = {look.face.appearance for look in looks}
    for alike in zip_longest(*(_of(look, known) for look in looks)):
        yield from filter(None, alike)


def _of(look: Appearance, known: Container[object]) -> Iterator[Other]:
    for change in (*_changes(look.face), *_other_dictionaries(look.face)):
        face = _changed(look.face, change)
        if face and face.appearance not in known:
            yield Other(look, face, tuple(change.items()))
    yield Other(look, look.face, ())


def _changes(face: Face) -> Iterator[dict[str, object]]:
    exchanged: dict[str, object] = {"columns": face.rows, "rows": face.columns}
    if face.pattern is Pattern.CHARUCO:
        yield {"legacy": not face.legacy}
        yield exchanged
        yield exchanged | {"legacy": not face.legacy}
        yield {"inverted": not face.inverted}
        return
    kalibr = face.numbering is Numbering.KALIBR
    yield exchanged
    yield {"numbering": (Numbering.TOP_LEFT if kalibr else Numbering.KALIBR).value}
    yield {"border_bits": 3 - face.border_bits}


def _changed(face: Face, change: dict[str, object]) -> Face | None:
    """The face changed; None where that changes nothing, or its dictionary cannot hold it."""
    typed = {
        key: Numbering(value) if key == "numbering" else value for key, value in change.items()
    }
    changed = replace(face, **typed)
    try:
        dictionary_of(changed)
    except TargetError:
        return None
    return None if changed == face or changed.border_bits < 1 else changed


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
