"""Every error that Trigpoint raises on purpose.

    TrigpointError
    ├── InputError      what the user gave is wrong: exit status 2
    │   ├── ConfigError     site.toml
    │   ├── TargetError     target.toml
    │   ├── MessageError    a payload or serial frame that does not decode
    │   └── RecordingError  an MCAP file that cannot be read
    └── OperationError  something failed while running: exit status 1
        ├── BusError        Zenoh
        ├── PortError       serial port
        ├── FrameError      picture source
        └── MissingExtraError  a part that is not installed here

A message says what, where, and what to do, in one line.
"""

import codecs
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class TrigpointError(Exception):
    """Root of the tree; `str()` is one line for a person."""

    exit_status = 1


class InputError(TrigpointError):
    """The user's input is wrong."""

    exit_status = 2


class ConfigError(InputError):
    """A site file is wrong."""


class TargetError(InputError):
    """A target file is wrong."""


class MessageError(InputError):
    """Bytes from outside do not decode."""


class RecordingError(InputError):
    """A session cannot be read."""


class OperationError(TrigpointError):
    """Something failed while running."""


class BusError(OperationError):
    """The bus could not be opened or used."""


class PortError(OperationError):
    """A serial port could not be opened or used."""


class FrameError(OperationError):
    """A picture source could not be opened or read."""


class MissingExtraError(OperationError):
    """A part of Trigpoint is not installed on this machine."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Wraps code that writes a file, or files in a folder: a failing disk becomes a one-line
    OperationError."""
    try:
        yield
    except OSError as reason:
        raise OperationError(
            f"{path}: cannot be written ({reason.strerror}); make room there or choose another"
        ) from None


def read_text(
    path: Path, kind: str, error: type[InputError], *, remedy: str = "check the path"
) -> str:
    """Return the file's text; raise `error` with a one-line message if that fails. `remedy`: what
    to do where there is no such file."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise error(f"{path}: there is no such {kind}; {remedy}") from None
    except OSError as reason:
        raise error(f"{path}: the {kind} cannot be read ({reason.strerror}); check it") from None
    return _decoded(data, path, kind, error)


def _decoded(data: bytes, path: Path, kind: str, error: type[InputError]) -> str:
    """The text with `\\n` at its lines' ends. What editors and shells of Windows write begins with
    a mark that says how it is to be read."""
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError as reason:
        if is_wide or b"\0" in data:
            raise error(f"{path}: this is not text, so it is no {kind}; check the path") from None
        line = data.count(b"\n", 0, reason.start) + 1
        raise error(f"{path}:{line}: this line is not UTF-8; save the {kind} as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")
