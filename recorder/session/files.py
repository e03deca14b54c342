"""The files of a session: where it is written, and which files in a folder are its parts."""

import logging
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from trigpoint.base.clock import NANOSECONDS
from trigpoint.base.errors import RecordingError
from trigpoint.recorder.mcap.file import McapIndex
from trigpoint.recorder.mcap.index import read_index
from trigpoint.recorder.mcap.rosbag_metadata import is_bag, listed_files, packs_messages
from trigpoint.site.config import Site

_LOG = logging.getLogger(__name__)

FILE = "session.mcap"
PART = "trigpoint.part"
"""Metadata of each part: `session`, an identity that all parts have, `part`, counted from 1, and
`repeated`, the keys whose first message here is the last one of the part before."""

LOSSES, CLOCK = "trigpoint.losses", "trigpoint.clock"
"""Metadata: key -> how many of its messages were lost so far in the session; log time -> by how
many seconds the clock was set then."""


def session_folder(site: Site, *, now_ns: int) -> Path:
    """A new folder for a session, named by the site and the time, in the recorder's directory."""
    time = datetime.fromtimestamp(now_ns // NANOSECONDS, UTC).strftime("%Y%m%dT%H%M%SZ")
    return site.path(site.recorder.directory) / f"{site.name}_{time}"


def session_path(site: Site, out: Path | None, *, now_ns: int) -> Path:
    """Where to record: `session.mcap` in `out`, or in a new folder of the recorder's directory.

    Where `out` has a session already (a recorder that was killed and started again), the next free
    name is taken: nothing is ever written over.
    """
    folder = out if out is not None else session_folder(site, now_ns=now_ns)
    taken = {file.name for file in folder.glob("*.mcap")}
    number = 1
    while (name := FILE if number == 1 else f"session_{number}.mcap") in taken:
        number += 1
    return folder / name


def part_path(first: Path, part: int) -> Path:
    """The file of a session's part, counted from 1."""
    return first if part == 1 else first.with_name(f"{first.stem}_part{part}{first.suffix}")


def _is_mcap(file: Path) -> bool:
    """Whether a file is MCAP, packed as a whole or not."""
    return ".mcap" in file.suffixes and not file.is_dir()


def session_files(path: Path, *, takes_several: bool = False) -> list[Path]:
    """The file, or the session's parts in a folder in their order; the folder itself where they are
    no MCAP or have their messages packed. Raises RecordingError where there is none, or, unless it
    `takes_several`, there are several sessions.

    A rosbag2's metadata.yaml decides, unless all files are one session of ours: what a killed
    recorder wrote last is not in it.
    """
    files = parts_of(path, takes_several=takes_several)
    lacking = faults(files)
    for file, fault in lacking.items():
        if len(lacking) == len(files):
            raise RecordingError(f"{file}: {fault}")
        _LOG.warning("%s: %s; the other files are read", file, fault)
    return [file for file in files if file not in lacking]


def faults(files: Sequence[Path]) -> dict[Path, str]:
    """The files of a session in which there is nothing, and why."""
    why = {
        False: "is listed in metadata.yaml, but not there; copy it too",
        True: "the file is empty; nothing was recorded into it",
    }
    return {file: why[file.exists()] for file in files if not _has_something(file)}


def _has_something(file: Path) -> bool:
    return file.is_dir() or (file.is_file() and file.stat().st_size > 0)


def parts_of(path: Path, *, takes_several: bool = False) -> list[Path]:
    """Like `session_files`, with those files in which there is nothing."""
    if not path.is_dir():
        if not path.exists():
            raise RecordingError(f"{path}: there is no such session; check the path")
        if packs_messages(path.parent, path.name):
            raise RecordingError(
                f"{path}: each of its messages is packed, as metadata.yaml says; give its folder"
            )
        return [path]
    files = sorted(path.glob("*.mcap"))
    readable = [file for file in files if _has_something(file)]
    parts = {file: read_index(file).metadata.get(PART, {}) for file in readable}
    sessions = {part.get("session", str(file)) for file, part in parts.items()}
    if len(sessions) == 1 and all(parts.values()):
        ordered = sorted(readable, key=lambda file: int(parts[file].get("part", "1")))
        return [*ordered, *(file for file in files if file not in parts)]
    if listed := listed_files(path):
        if all(map(_is_mcap, listed)) and not packs_messages(path):
            return listed
        for file, fault in faults(listed).items():
            raise RecordingError(f"{file}: {fault}")
        return [path]
    files = files or sorted(file for file in path.iterdir() if file.is_file() and is_bag(file))
    if not files:
        raise RecordingError(f"{path}: there is no .mcap file in this folder; check the path")
    if sum(map(_has_something, files)) > 1 and not takes_several:
        names = ", ".join(file.name for file in files)
        raise RecordingError(
            f"{path}: several sessions in this folder ({names}); name one, or "
            f"where they are one bag: ros2 bag reindex {path}"
        )
    return files


def spans(folder: Path) -> list[tuple[Path, int, int]]:
    """Every file of the recordings in a folder and in its folders, or the one file, with its first
    and last log time, ns, in order of time. What is no MCAP file, or has no messages, is left
    out."""
    found = []
    files = [*folder.glob("*.mcap"), *folder.glob("*/*.mcap")]
    for file in [folder] if folder.is_file() else files:
        try:
            chunks = read_index(file).chunks
        except RecordingError:
            continue
        if chunks:
            first_ns = min(chunk.start_ns for chunk in chunks)
            found.append((file, first_ns, max(chunk.end_ns for chunk in chunks)))
    return sorted(found, key=lambda span: span[1:])


def repeated_keys(part: McapIndex) -> set[str]:
    """Keys whose first message in this part repeats the part before."""
    return set(filter(None, part.metadata.get(PART, {}).get("repeated", "").split(",")))
