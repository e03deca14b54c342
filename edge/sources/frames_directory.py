"""`dir://FOLDER`: the pictures of a folder by name, at the camera's rate.

`dir://FOLDER?loop=1` begins again at its end; `dir://FOLDER?follow=1` waits there for pictures that
are still to be written.
"""

import logging
import threading
from collections.abc import Iterator
from pathlib import Path

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.base.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.site.config import CameraConfig

from .frames import Frame, Unreadable, place_and_options
from .picture_files import (
    PICTURE_SUFFIXES,
    check_orientations,
    listed_pictures,
    pictures_in,
    read_picture,
)

_log = logging.getLogger(__name__)

_OPTIONS = ("loop", "follow")
_LOOK_S = 0.2
_SETTLED_S = 2.0
"""A file that cannot be read and has not changed for so long is not being written any more."""


class DirectoryFrames:
    """The pictures of a folder, stamped with the time at which they are handed out.

    Stills have no time of their own, so none is skipped for a slow taker: the next just comes late.
    """

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        """Raises InputError for a missing folder, one without pictures unless it is followed, and
        pictures that EXIF turns differently."""
        place, options = place_and_options(url, _OPTIONS)
        self._folder, self._clock = Path(place), clock
        self._loops, self._follows = (_is_on(place, options, name) for name in _OPTIONS)
        if self._loops and self._follows:
            raise InputError(f"{place}: it can loop or follow, not both; leave one option out")
        self._files = listed_pictures(self._folder) if self._follows else pictures_in(self._folder)
        if not self._follows:
            check_orientations(self._files)
        self._period_ns = to_ns(1 / camera.rate)
        self._first: Path | None = None
        self._spoilt: set[Path] = set()
        self._changed: dict[Path, tuple[tuple[int, int], int]] = {}

    @property
    def intrinsics(self) -> CameraModel | None:
        """Files do not tell."""
        return None

    @property
    def skipped(self) -> int:
        """None is."""
        return 0

    def frames(self, stopping: threading.Event) -> Iterator[Frame | Unreadable | None]:
        """Pictures until the folder's end; of those that cannot be read the log names each once.

        None while a folder that is followed has no new one. Raises InputError where none can be
        read.
        """
        due_ns = self._clock.elapsed_ns()
        trouble = None
        for file in self._followed(stopping) if self._follows else self._played():
            if file is None:
                yield None
                continue
            wait_ns = due_ns - self._clock.elapsed_ns()
            if self._clock.wait(stopping, max(0.0, to_seconds(wait_ns))):
                return
            due_ns = max(due_ns + self._period_ns, self._clock.elapsed_ns())
            try:
                picture = read_picture(file)
            except InputError as reason:
                if file not in self._spoilt:
                    _log.warning("%s; it is left out", reason)
                self._spoilt.add(file)
                trouble = reason
                yield Unreadable(str(reason))
                continue
            self._first = self._first or file
            yield Frame(picture, self._clock.now_ns(), name=file.name)
            due_ns = max(due_ns, self._clock.elapsed_ns())
        if trouble is not None and self._first is None and not stopping.is_set():
            raise trouble

    def close(self) -> None:
        """Nothing is held open."""

    def _played(self) -> Iterator[Path]:
        """The files once, or over and over as long as one of them can be read."""
        yield from self._files
        while self._loops and self._first is not None:
            yield from self._files

    def _followed(self, stopping: threading.Event) -> Iterator[Path | None]:
        """Every file once it is whole, or given up, by name among those that are; None between."""
        done: set[Path] = set()
        while not stopping.is_set():
            for file in listed_pictures(self._folder):
                is_new = file not in done and file.suffix.lower() in PICTURE_SUFFIXES
                if is_new and self._is_written(file):
                    done.add(file)
                    yield file
            yield None
            self._clock.wait(stopping, _LOOK_S)

    def _is_written(self, file: Path) -> bool:
        """Whether a file can be read, or will not change any more; raises InputError where EXIF
        turns it otherwise than the first."""
        try:
            read_picture(file)
        except InputError:
            return self._is_settled(file)
        check_orientations([self._first or file, file])
        return True

    def _is_settled(self, file: Path) -> bool:
        try:
            status = file.stat()
        except OSError:
            return False  # it was taken away meanwhile
        now_ns, state = self._clock.elapsed_ns(), (status.st_size, status.st_mtime_ns)
        last, since_ns = self._changed.get(file, (state, now_ns))
        self._changed[file] = (state, since_ns if state == last else now_ns)
        return now_ns - self._changed[file][1] > to_ns(_SETTLED_S)


def _is_on(place: str, options: dict[str, str], name: str) -> bool:
    value = options.get(name, "0")
    if value not in ("0", "1"):
        raise InputError(f"{place}: {name} is «{value}»; write {name}=1 or {name}=0")
    return value == "1"
