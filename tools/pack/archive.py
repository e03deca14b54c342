"""An archive whose bytes depend on its files alone: no time, no user, one order."""

import gzip
import io
import tarfile
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from trigpoint.base.disk import replace_file
from trigpoint.base.errors import writing

from .contents import PRIVATE, Packed

_FOLDER_MODE, _KEYS_MODE = 0o755, 0o700


def write_archive(path: Path, folder: str, files: Iterable[Packed]) -> None:
    """Write a tar.gz in which everything lies in one folder. It may hold keys, so that only its
    owner can read it. Raises OperationError."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        data = _compressed(folder, sorted(files, key=lambda packed: packed.path))
        replace_file(path, data, mode=PRIVATE)


def _compressed(folder: str, files: list[Packed]) -> bytes:
    buffer = io.BytesIO()
    with (
        gzip.GzipFile(filename="", mode="wb", fileobj=buffer, mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as tar,
    ):
        for name, mode in _folders(files).items():
            entry = tarfile.TarInfo(f"{folder}/{name}".rstrip("/"))
            entry.type, entry.mode = tarfile.DIRTYPE, mode
            tar.addfile(entry)
        for file in files:
            entry = tarfile.TarInfo(f"{folder}/{file.path}")
            entry.size, entry.mode = len(file.data), file.mode
            tar.addfile(entry, io.BytesIO(file.data))
    return buffer.getvalue()


def _folders(files: list[Packed]) -> dict[str, int]:
    """Folder -> mode, the outer ones first; one that holds a private file is its owner's."""
    found: dict[str, int] = {"": _FOLDER_MODE}
    for file in files:
        *outer, inner = [str(one) for one in reversed(PurePosixPath(file.path).parents)]
        for one in (*outer, inner):
            found.setdefault("" if one == "." else one, _FOLDER_MODE)
        if file.mode == PRIVATE:
            found["" if inner == "." else inner] = _KEYS_MODE
    return dict(sorted(found.items()))
