"""Frames on a serial line: kind, sequence number, payload and CRC-16, stuffed by COBS, ended by 0.

docs/reference/serial.md describes this byte by byte. COBS: Cheshire and Baker, «Consistent overhead
byte stuffing» (1999); the CRC is CRC-16/CCITT, polynomial 0x1021, initial value 0xFFFF, nothing
reflected.
"""

import binascii
import struct

from msgspec import Struct

from trigpoint.robot.line.protocol import Damaged, DamageKind

DELIMITER = b"\0"
SEQUENCES = 1 << 16
# COBS adds one byte to each 254; so every frame costs exactly one, and both ways of a clock
# exchange take equally long.
MAXIMUM_FRAME = 250
_HEADER = struct.Struct("<BH")
_CRC = struct.Struct("<H")
MAXIMUM_PAYLOAD = MAXIMUM_FRAME - _HEADER.size - _CRC.size
_MAXIMUM_ENCODED = MAXIMUM_FRAME + 1


class Frame(Struct, frozen=True):
    """One frame; `sequence`: 0 … 65535, counts the sender's frames, then starts again."""

    kind: int
    sequence: int
    payload: bytes


def crc16(data: bytes) -> int:
    """CRC-16/CCITT of the bytes; of `b"123456789"` it is 0x29B1."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode_frame(frame: Frame) -> bytes:
    """The frame's bytes with the delimiter at the end."""
    if len(frame.payload) > MAXIMUM_PAYLOAD:
        raise ValueError(f"a payload of {len(frame.payload)} bytes; at most {MAXIMUM_PAYLOAD} fit")
    body = _HEADER.pack(frame.kind, frame.sequence) + frame.payload
    return _stuffed(body + _CRC.pack(crc16(body))) + DELIMITER


def decode_frame(encoded: bytes) -> Frame | Damaged:
    """The frame in the bytes between two delimiters."""
    body = _unstuffed(encoded)
    if body is None or not _HEADER.size + _CRC.size <= len(body) <= MAXIMUM_FRAME:
        return Damaged(DamageKind.FRAMING)
    content, (crc,) = body[: -_CRC.size], _CRC.unpack(body[-_CRC.size :])
    if crc16(content) != crc:
        return Damaged(DamageKind.CHECKSUM)
    kind, sequence = _HEADER.unpack_from(content)
    return Frame(kind, sequence, content[_HEADER.size :])


def _stuffed(body: bytes) -> bytes:
    """Each run between zeros, with the length to the next zero before it; 253 bytes at most, so
    that no run needs a second length."""
    return b"".join(bytes([len(run) + 1]) + run for run in body.split(DELIMITER))


def _unstuffed(encoded: bytes) -> bytes | None:
    """What was stuffed; None where a length points beyond the end, or to no run of ours."""
    runs, at = [], 0
    while at < len(encoded):
        end = at + encoded[at]
        if not at < end <= min(len(encoded), at + _MAXIMUM_ENCODED):
            return None
        runs.append(encoded[at + 1 : end])
        at = end
    return DELIMITER.join(runs)


class FrameReader:
    """Bytes in, frames out, however the bytes are cut; holds at most one frame's bytes."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._is_overlong = False
        # What comes before the first delimiter may be the end of a frame that began before we
        # listened; it is no damage.
        self._is_synchronised = False

    def feed(self, data: bytes) -> list[Frame | Damaged]:
        """Every frame that `data` completes, and what was damaged, in order."""
        found = []
        *ended, rest = data.split(DELIMITER)
        for piece in ended:
            self._hold(piece)
            found += self._end()
        self._hold(rest)
        return found

    def _hold(self, piece: bytes) -> None:
        if len(self._buffer) + len(piece) > _MAXIMUM_ENCODED:
            self._is_overlong = True
            self._buffer.clear()
        elif not self._is_overlong:
            self._buffer += piece

    def _end(self) -> list[Frame | Damaged]:
        encoded, is_overlong = bytes(self._buffer), self._is_overlong
        was_synchronised = self._is_synchronised
        self._buffer.clear()
        self._is_overlong, self._is_synchronised = False, True
        if not encoded and not is_overlong:
            return []
        item = Damaged(DamageKind.FRAMING) if is_overlong else decode_frame(encoded)
        return [item] if was_synchronised or isinstance(item, Frame) else []


class FrameWriter:
    """Numbers the frames of one direction."""

    def __init__(self) -> None:
        self._sequence = 0

    def write(self, kind: int, payload: bytes) -> bytes:
        """The bytes of the next frame."""
        frame = Frame(kind, self._sequence, payload)
        self._sequence = (self._sequence + 1) % SEQUENCES
        return encode_frame(frame)


class SequenceCheck:
    """Counts the frames of one direction that did not arrive."""

    def __init__(self) -> None:
        self._expected: int | None = None

    def missing(self, sequence: int) -> int:
        """How many frames are missing before this one; 0 for the first."""
        missing = 0 if self._expected is None else (sequence - self._expected) % SEQUENCES
        self._expected = (sequence + 1) % SEQUENCES
        return missing
