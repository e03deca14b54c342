"""Where pictures come from. One source, one class; `SOURCES` says which URL scheme opens which."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trigpoint.geometry import CameraModel


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture. `picture`: (height, width) or (height, width, 3) uint8, BGR as OpenCV's;
    `captured_ns`: middle of exposure, Unix time on this machine's clock."""

    picture: np.ndarray
    captured_ns: int


class FrameSource(Protocol):
    """An open source. Built as `Source(url, camera, clock=clock)` with a CameraConfig and a Clock;
    raises FrameError where it cannot be opened."""

    @property
    def intrinsics(self) -> CameraModel | None:
        """The lens, where the source itself knows it."""
        ...

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Pictures in order of time, the newest first served: a slow taker skips pictures.

        Ends at the end of a file or soon after `stopping` is set; raises FrameError when the
        source is lost.
        """
        ...

    @property
    def skipped(self) -> int:
        """How many pictures were made but not handed out, since the taker was slow."""
        ...

    def close(self) -> None: ...
