"""Boards that people may mean when they describe another one, and what they should write."""

from collections.abc import Container, Iterable, Iterator
from functools import lru_cache
from itertools import chain, product, zip_longest

import cv2
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.errors import TargetError
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.edge.registration.dictionaries import dictionary_of
from trigpoint.site.target import Face, Numbering, Pattern

UNMIRROR = "switch off the mirroring (flip) where they are made"


class Other(Struct, frozen=True):
    """A board that may be meant by a look. `change`: what differs, as the target file has it."""

    look: Appearance
    face: Face
    change: tuple[tuple[str, object], ...]
    is_mirrored: bool = False

    @property
    def differences(self) -> int:
        """In how many things the look differs."""
        return len(self.change) + self.is_mirrored

    @property
    def markers(self) -> set[tuple[str, int]]:
        """The kind and the id of each of its markers."""
        return markers_of(self.face, range(self.face.marker_count))

    @property
    def remedy(self) -> str:
        """What is seen, and what to write, in one line."""
        written = " and ".join(f"{key} = {toml(value)}" for key, value in self.change)
        seen = ["mirrored"] * self.is_mirrored + [f"with {written}"] * bool(written)
        steps = [UNMIRROR] * self.is_mirrored
        steps += [f"write {written}"] * bool(written)
        return (
            f"{self.look.words}: the pictures show this board {' and '.join(seen)}, so it is not "
            f"used; {', and '.join(steps)}"
        )


class Reading(Struct, frozen=True):
    """One way to read a look's markers: as those of `face`, which is the look's but for what they
    are. `others`: boards of such markers that people mean, the simplest change first: they differ
    by where which marker is."""

    look: Appearance
    face: Face
    is_mirrored: bool
    others: tuple[Other, ...]


@lru_cache(16)
def readings(looks: tuple[Appearance, ...]) -> tuple[Reading, ...]:
    """The likeliest of every look first; only boards that can be, and that no target has. The same
    for every camera of an agent."""
    known = {look.face.appearance for look in looks}
    alike = zip_longest(*(_of(look, known) for look in looks))
    return tuple(filter(None, chain.from_iterable(alike)))


def _of(look: Appearance, known: Container[object]) -> Iterator[Reading]:
    """What people get wrong comes together: a board that is described after another one."""
    alike: list[tuple[int, Reading]] = []
    for is_mirrored, read in product((False, True), _readings(look.face)):
        changes = [
            read | placed for placed in _places(look.face) if read.keys() <= _usual(look.face)
        ]
        faces = [(_changed(look.face, change), change) for change in changes]
        found = tuple(
            Other(look, face, tuple(change.items()), is_mirrored)
            for face, change in faces
            if face and (face.appearance not in known or (is_mirrored and not change))
        )
        reading = Reading(look, replace(look.face, **read), is_mirrored, found)
        alike.append((len(read) + is_mirrored, reading))
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


def _usual(face: Face) -> set[str]:
    """What people get wrong of a board's markers: the border of a small code beside which other
    things lie reads as another one."""
    return {"dictionary", "inverted" if face.pattern is Pattern.CHARUCO else "border_bits"}


def _readings(face: Face) -> Iterator[dict[str, object]]:
    """Changes of what the markers are; none first."""
    border: dict[str, object] = {"border_bits": 2 if face.border_bits == 1 else 1}
    prints = {}, border, {"inverted": not face.inverted}
    for printed, dictionary in product(prints, ({}, *_other_dictionaries(face))):
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
    return changed


def _other_dictionaries(face: Face) -> Iterator[dict[str, object]]:
    """One of each other kind: as large as the face's, else the largest, since the smaller ones of a
    kind are the first of it."""
    mine = (face.dictionary or "").upper()
    kinds: dict[str, list[str]] = {}
    for name in sorted(dir(cv2.aruco)):
        if name.startswith("DICT_"):
            kinds.setdefault(kind_of(name), []).append(name)
    size = mine.rpartition("_")[2]
    for kind, names in kinds.items():
        if kind != kind_of(mine):
            same = [name for name in names if name == f"{kind}_{size}"]
            yield {"dictionary": (same or sorted(names, key=lambda n: (len(n), n)))[-1]}


def kind_of(name: str) -> str:
    """«DICT_4X4» of DICT_4X4_50; names of other kinds whole, in capitals."""
    upper = name.upper()
    return upper.rpartition("_")[0] if upper[5:6].isdigit() else upper


def markers_of(face: Face, numbers: Iterable[int]) -> set[tuple[str, int]]:
    """The kind and the id of those of a face's markers."""
    kind = kind_of(face.dictionary or "")
    return {(kind, face.first_marker + number) for number in numbers}


def toml(value: object) -> str:
    """A key's value as the target file has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, int) else f'"{value}"'
