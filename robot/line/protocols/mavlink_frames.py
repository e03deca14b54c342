"""MAVLink frames out of bytes, by their checksum: what damage holds back is one frame at most.

pymavlink's own reader believes a length byte that garbage holds and waits for as many bytes; so the
bytes are looked at from each start marker on, and a frame counts when its checksum does (and its
signature, where a key is configured).
"""

import hashlib
import hmac
from types import ModuleType
from typing import Any

from trigpoint.base.errors import OperationError
from trigpoint.base.words import install_command

VERSION_1, VERSION_2 = 0xFE, 0xFD
_HEADS = {VERSION_1: 6, VERSION_2: 10}
_CHECKSUM, _SIGNATURE = 2, 13
_DIGEST = 6
_SIGNED = 0x01
# 2015-01-01, which signatures count from, in units of 10 µs.
_SIGNING_EPOCH_NS = 1_420_070_400 * 10**9
_LONGEST = 255 + 10 + _CHECKSUM + _SIGNATURE


def dialect() -> ModuleType:
    """ArduPilot's messages, which the common ones are part of; raise OperationError where pymavlink
    is not installed."""
    try:
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError:
        raise OperationError(
            f"pymavlink is not installed; run: {install_command('robot,mavlink')}"
        ) from None
    return ardupilotmega


def wire(system: int, component: int, key: bytes, unix_ns: int) -> Any:
    """pymavlink's codec for messages of ours; it signs with `key` where that is not empty, with
    time stamps from `unix_ns` on, so that those of a later start are above."""
    codec = dialect().MAVLink(None, srcSystem=system, srcComponent=component)
    if key:
        codec.signing.secret_key = key
        codec.signing.sign_outgoing = True
        codec.signing.timestamp = max(0, unix_ns - _SIGNING_EPOCH_NS) // 10_000
    return codec


class MavlinkReader:
    """Bytes in, messages out, however the bytes are cut. Holds one frame's bytes at most."""

    def __init__(self, key: bytes) -> None:
        self._codec: Any = dialect().MAVLink(None)
        self._key = key
        if key:
            self._codec.signing.secret_key = key
        self._error: type[Exception] = dialect().MAVError
        self.reset()

    def reset(self) -> None:
        """The port was opened: forget what was half received."""
        self._buffer = bytearray()
        self._damaged = 0
        self._is_synchronised = False

    def take_damaged(self) -> int:
        """How many stretches of bytes were thrown away since this was asked last."""
        damaged, self._damaged = self._damaged, 0
        return damaged

    def feed(self, data: bytes) -> list[Any]:
        """Every sound message that `data` completes, in order."""
        self._buffer += data
        found = []
        while (message := self._next()) is not None:
            found.append(message)
        return found

    def _next(self) -> Any | None:
        """The first sound message in the buffer, which loses what was before it."""
        first_open: int | None = None
        for begin, byte in enumerate(self._buffer):
            if byte not in _HEADS:
                continue
            end = self._end(begin)
            if end is None or end > len(self._buffer):
                first_open = begin if first_open is None else first_open
                continue
            message = self._decoded(begin, end)
            if message is not None:
                self._drop(begin)
                del self._buffer[: end - begin]
                self._is_synchronised = True
                return message
        self._drop(len(self._buffer) if first_open is None else first_open)
        return None

    def _end(self, begin: int) -> int | None:
        """Where a frame that begins here ends; None where that is not yet told."""
        buffer = self._buffer
        head = _HEADS[buffer[begin]]
        if len(buffer) < begin + head:
            return None
        end = begin + head + buffer[begin + 1] + _CHECKSUM
        is_signed = head == _HEADS[VERSION_2] and bool(buffer[begin + 2] & _SIGNED)
        return end + (_SIGNATURE if is_signed else 0)

    def _decoded(self, begin: int, end: int) -> Any | None:
        """The message, where the checksum and the signature say that it is one."""
        frame = bytearray(self._buffer[begin:end])
        if frame[0] == VERSION_2 and frame[2] & ~_SIGNED:
            return None  # a flag that a receiver must understand, and none is known
        if self._key and not self._is_signed_by_us(frame):
            return None
        try:
            message = self._codec.decode(frame)
        except self._error:
            return None
        # Of a message that is not in the dialect, nobody can tell the checksum.
        return None if message.get_type().startswith("UNKNOWN") else message

    def _is_signed_by_us(self, frame: bytearray) -> bool:
        """Whether the signature is right. pymavlink looks too, but keeps the time stamp of a frame
        whose signature is wrong, so that a stranger's frame would shut the right ones out."""
        if frame[0] != VERSION_2 or not frame[2] & _SIGNED:
            return False
        digest = hashlib.sha256(self._key + frame[:-_DIGEST]).digest()
        return hmac.compare_digest(digest[:_DIGEST], bytes(frame[-_DIGEST:]))

    def _drop(self, count: int) -> None:
        if count and self._is_synchronised:
            self._damaged += 1
        del self._buffer[:count]
