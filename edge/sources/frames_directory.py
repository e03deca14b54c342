"""`dir://FOLDER`: the pictures of a folder by name, at the camera's rate."""

import logging
import threading
from collections.abc import Iterator

from trigpoint.clock import Clock, to_ns, to_seconds
from trigpoint.config import CameraConfig
from trigpoint.errors import InputError
from trigpoint.geometry import CameraModel

from .frames import Frame, local_path
from .picture_files import pictures_in, read_picture

_log = logging.getLogger(__name__)


class DirectoryFrames:
    """Every picture of a folder once, stamped with the time at which it is handed out.

    Stills have no time of their own, so none is skipped for a slow taker: the next just comes late.
    """

    def __init__(self, url: str, camera: CameraConfig, *, clock: Clock) -> None:
        """Raises InputError for a missing folder or one without pictures."""
        self._files = pictures_in(local_path(url))
        self._clock = clock
        self._period_ns = to_ns(1 / camera.rate)

    @property
    def intrinsics(self) -> CameraModel | None:
        """Files do not tell."""
        return None

    @property
    def skipped(self) -> int:
        """None is."""
        return 0

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Pictures until the folder's end; one that cannot be read is left out, which the log says.

        Raises InputError where none can be.
        """
        due_ns = self._clock.elapsed_ns()
        unreadable, trouble = 0, None
        is_any_sound = False
        for file in self._files:
            wait_ns = due_ns - self._clock.elapsed_ns()
            if self._clock.wait(stopping, max(0.0, to_seconds(wait_ns))):
                return
            try:
                picture = read_picture(file)
            except InputError as reason:
                _log.warning("%s; it is left out", reason)
                unreadable, trouble = unreadable + 1, reason
                continue
            yield Frame(picture, self._clock.now_ns(), unreadable=unreadable)
            unreadable, is_any_sound = 0, True
            due_ns = max(due_ns + self._period_ns, self._clock.elapsed_ns())
        if trouble is not None and not is_any_sound:
            raise trouble

    def close(self) -> None:
        """Nothing is held open."""
