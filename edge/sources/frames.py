"""Where pictures come from. One source, one class; `SOURCES` says which URL scheme opens which.

Further schemes are plug-ins: entry points of the group `trigpoint.frames` whose name is the scheme.
"""

import threading
from collections.abc import Callable, Collection, Iterator
from difflib import get_close_matches
from enum import StrEnum
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Protocol
from urllib.parse import parse_qsl

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import Clock
from trigpoint.base.errors import InputError
from trigpoint.geometry import CameraModel
from trigpoint.site.config import CameraConfig

SOURCES: dict[str, str] = {
    "dir": "trigpoint.edge.sources.frames_directory:DirectoryFrames",
    "file": "trigpoint.edge.sources.frames_video:VideoFrames",
    "v4l2": "trigpoint.edge.sources.frames_v4l2:V4l2Frames",
    "rtsp": "trigpoint.edge.sources.frames_rtsp:RtspFrames",
}
STREAMED = ("file", "rtsp")
"""Those that PyAV reads, which the extra `streams` installs."""
PLUG_INS = "trigpoint.frames"
_LOCAL_SCHEMES = ("dir", "file")


class Stamp(StrEnum):
    """How a picture's time is known."""

    SOURCE = "by the source"
    MONOTONIC = "by the kernel's monotonic clock"
    REALTIME = "by the kernel's real-time clock"
    ARRIVAL = "on arrival"
    SENDER = "by the sender's clock"


class Frame(Struct, frozen=True):
    """One picture. `picture`: grey or BGR as OpenCV's, (height, width) or (height, width, 3) of any
    depth, which the agent scales to 8 bits; `captured_ns`: middle of exposure, Unix time on this
    machine's clock.

    `passed_over`: how many pictures before it were left out, since they came faster than the
    camera's rate in the site file, or were the same again. `is_frozen`: the camera has given this
    very picture for so long that it says nothing of its time. `name`: the file's, where it is one.
    """

    picture: np.ndarray
    captured_ns: int
    stamp: Stamp = Stamp.SOURCE
    passed_over: int = 0
    is_frozen: bool = False
    name: str = ""


class Unreadable(Struct, frozen=True):
    """A picture that came and cannot be read, and why."""

    reason: str


class FrameSource(Protocol):
    """An open source. Built as `Source(url, camera, clock=clock)` with a CameraConfig and a Clock.

    The constructor raises InputError where the URL names nothing that can be opened, now or later
    (a missing file), and FrameError where it may come back (a camera that is unplugged).
    """

    @property
    def intrinsics(self) -> CameraModel | None:
        """The lens, where the source itself knows it."""
        ...

    def frames(self, stopping: threading.Event) -> Iterator[Frame | Unreadable | None]:
        """Pictures in order of time; a slow consumer skips to the newest.

        None, now and then, where it is right that none comes for long. Ends at the end of a file
        or soon after `stopping` is set; raises FrameError when the source is lost.
        """
        ...

    @property
    def skipped(self) -> int:
        """How many pictures were made but not handed out, since the consumer was slow."""
        ...

    def close(self) -> None: ...


def open_source(url: str, camera: CameraConfig, *, clock: Clock, directory: Path) -> FrameSource:
    """Open the source of a URL; paths in dir:// and file:// start from `directory`.

    Raises InputError for an unknown scheme, and what the source's constructor raises.
    """
    scheme, _, rest = url.partition("://")
    if scheme in _LOCAL_SCHEMES:
        url = f"{scheme}://{directory / rest}"
    return source_class(scheme)(url, camera, clock=clock)


def source_class(scheme: str) -> Callable[..., FrameSource]:
    """The class behind a scheme; raise InputError that lists the known ones."""
    if scheme in SOURCES:
        return EntryPoint(scheme, SOURCES[scheme], PLUG_INS).load()
    plug_ins = entry_points(group=PLUG_INS)
    if scheme not in plug_ins.names:
        known = ", ".join(f"{name}://" for name in sorted({*SOURCES, *plug_ins.names}))
        raise InputError(f"pictures from «{scheme}://» are not known here; use one of {known}")
    return plug_ins[scheme].load()


def local_path(url: str) -> Path:
    """The part behind the scheme, as a path."""
    return Path(url.partition("://")[2])


def without_password(url: str) -> str:
    """The URL without what logs must not hold."""
    scheme, separator, rest = url.partition("://")
    authority, slash, path = rest.partition("/")
    return scheme + separator + authority.rpartition("@")[2] + slash + path


def place_and_options(url: str, known: Collection[str]) -> tuple[str, dict[str, str]]:
    """What stands before a URL's question mark, without the scheme, and the options behind it.

    Raises InputError for an option that is not `known`.
    """
    place, _, query = url.partition("://")[2].partition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    for key in options:
        if key not in known:
            near = get_close_matches(key, known, n=1)
            hint = f"did you mean «{near[0]}»?" if near else f"it takes {', '.join(known)}"
            raise InputError(f"{place}: this source has no option «{key}»; {hint}")
    return place, options
