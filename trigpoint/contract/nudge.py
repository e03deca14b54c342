"""What a camera's agent says in its diagnostics when its camera was turned or shifted.

Diagnostics are sent once a second and may be lost; so it is said again for as long as the agent
runs.
"""

from collections.abc import Iterator

from msgspec import Struct

from trigpoint.contract.messages import Diagnostics

NUDGED = "nudged_between"
"""The value: the stamps, ns, of the last picture from the old place and the first from the new."""
NUDGES = "nudges"
"""The counter."""
_EDGE = "edge/"


class Nudge(Struct, frozen=True):
    """A camera was moved after its picture of `until_ns`, and not after that of `since_ns`."""

    camera: str
    until_ns: int
    since_ns: int

    @property
    def value(self) -> str:
        """It as the value in the diagnostics."""
        return f"{self.until_ns} {self.since_ns}"


def may_tell_of_nudges(payload: bytes) -> bool:
    """Whether encoded diagnostics may have the value; most have not, and need not be decoded."""
    return NUDGED.encode() in payload


def nudges_in(message: Diagnostics) -> Iterator[Nudge]:
    """The nudges that diagnostics tell of; a value that is none is passed over."""
    for status in message.statuses:
        parts = status.values.get(NUDGED, "").split()
        if status.name.startswith(_EDGE) and len(parts) == 2 and all(map(_is_stamp, parts)):
            until_ns, since_ns = map(int, parts)
            if until_ns < since_ns:
                yield Nudge(status.name.removeprefix(_EDGE), until_ns, since_ns)


def _is_stamp(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 20
