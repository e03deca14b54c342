"""Files that are replaced whole, with a head and a checksum, and what is in them as msgpack."""

import os
import zlib
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

_Value = TypeVar("_Value")

_CHECK = 4  # bytes of the checksum


def save_checked(
    path: Path, magic: bytes, *body: bytes | memoryview, is_synced: bool = True
) -> None:
    """Replace a file by a body in parts; a killed process leaves the one before. `is_synced`: only
    once the disk has it. Raises OSError where the disk does not take it."""
    part, check = path.with_suffix(".part"), 0
    for some in body:
        check = zlib.crc32(some, check)
    with part.open("wb") as file:  # which takes what is large as it is
        file.writelines((magic + check.to_bytes(_CHECK, "little"), *body))
        if is_synced:
            file.flush()
            os.fsync(file.fileno())
    part.replace(path)


def checked_body(data: bytes, magic: bytes) -> bytes | None:
    """The body of a file's bytes; None where they are not whole, or of another kind."""
    body = data[len(magic) + _CHECK :]
    check = int.from_bytes(data[len(magic) :][:_CHECK], "little")
    return body if data.startswith(magic) and zlib.crc32(body) == check else None


def packed(value: object) -> bytes:
    """A value as msgpack, arrays of numpy in it too."""
    return msgspec.msgpack.encode(value, enc_hook=_plain)


def unpacked(data: bytes | memoryview, kind: type[_Value]) -> _Value:
    """The value of a kind that was packed; raise ValueError where there is none."""
    return msgspec.msgpack.decode(data, type=kind, dec_hook=_array)


def _plain(value: Any) -> object:
    """What msgpack does not have, by what it has."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise NotImplementedError(f"no form for {type(value)}")


def _array(_type: Any, plain: Any) -> np.ndarray:
    """An array of a document; ValueError where it is none."""
    kind, shape, data = plain
    return np.frombuffer(data, kind).reshape(shape).copy()
