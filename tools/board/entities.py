"""What the page shows, as named records of plain values, and the changes between two states.

An entity's name begins with its kind: `camera/c1`, `robot/r1`, `node/edge/c1`, `alarm/7`, `site`.
"""

from collections.abc import Mapping

from msgspec import Struct

Fields = dict[str, object]
Entities = dict[str, Fields]


class Change(Struct, frozen=True, omit_defaults=True):
    """From one state to the next: `t`: Unix time, s; `set`: the fields that differ, by entity;
    `gone`: entities that are no more."""

    t: float
    set: Entities = {}
    gone: tuple[str, ...] = ()

    @property
    def is_empty(self) -> bool:
        return not self.set and not self.gone


class Whole(Struct, frozen=True, omit_defaults=True):
    """A whole state at a time, and the way (x and y in turn, m) that each robot came in the minute
    before. `past`: it is not the newest one."""

    t: float
    all: Entities
    ways: dict[str, list[float]] = {}
    past: bool = False


def difference(shown: Entities, now: Mapping[str, Fields | None], t: float) -> Change:
    """What differs from `shown` in the entities of `now`; None there: it is gone."""
    found: Entities = {}
    for name, fields in now.items():
        if fields is None:
            continue
        before = shown.get(name, {})
        if other := {key: value for key, value in fields.items() if before.get(key) != value}:
            found[name] = other
    gone = tuple(name for name, fields in now.items() if fields is None and name in shown)
    return Change(t, found, gone)


def apply(shown: Entities, change: Change) -> None:
    """Make `shown` the state after a change. Records are replaced, never changed."""
    for name, fields in change.set.items():
        shown[name] = shown.get(name, {}) | fields
    for name in change.gone:
        shown.pop(name, None)
