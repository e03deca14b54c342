"""The attachment of a correction: its map, and its sequence number. On a secured site an
authenticator follows (`authenticator`)."""

import struct
from uuid import UUID

from msgspec import Struct

from trigpoint.base.errors import MessageError

_SEQUENCE = struct.Struct("<Q")
LEAST_SIGMA = 1e-5
"""Of what a correction is true to: ten micrometres or microradians. No camera resolves that, and
the square of much less is exactly zero in single precision."""
MARK_LENGTH = 16 + _SEQUENCE.size


class CorrectionMark(Struct, frozen=True):
    """`map_id`: the map's UUID; `sequence`: counts one robot's corrections, 0 … 2⁶⁴ - 1."""

    map_id: UUID
    sequence: int


def encode_mark(mark: CorrectionMark) -> bytes:
    """24 bytes: the UUID's 16 in the order of its text, then the sequence, little-endian uint64."""
    return mark.map_id.bytes + _SEQUENCE.pack(mark.sequence)


def decode_mark(attachment: bytes) -> CorrectionMark:
    """The mark in an attachment; raise MessageError if it is not one."""
    if len(attachment) != MARK_LENGTH:
        raise MessageError(
            f"a correction's attachment has {len(attachment)} bytes; it needs {MARK_LENGTH}: "
            "the map's UUID and a sequence number"
        )
    return CorrectionMark(UUID(bytes=attachment[:16]), _SEQUENCE.unpack(attachment[16:])[0])


class MissedCorrections:
    """Counts the corrections sent to one robot that never arrived, by the gaps in their numbers.
    They are not requested again: a correction is only valid for its moment."""

    def __init__(self) -> None:
        self._last: tuple[CorrectionMark, str] | None = None

    def before(self, mark: CorrectionMark, sender: str) -> int:
        """How many are missing between the last one and this one; 0 if the map or the sending
        session changed, since a restarted fusion skips numbers."""
        last, self._last = self._last, (mark, sender)
        if last is None or (last[0].map_id, last[1]) != (mark.map_id, sender):
            return 0
        return max(0, mark.sequence - last[0].sequence - 1)
