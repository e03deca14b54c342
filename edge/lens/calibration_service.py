"""What an agent keeps of its sightings for a calibration, and the command that asks for one."""

import json
import threading
from collections.abc import Sequence

import numpy as np

from trigpoint.base.errors import InputError, OperationError
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Target

from .calibration import calibrate, outer_pixels
from .calibration_text import calibration_record
from .calibration_views import View, views_of
from .rolling_shutter import ShutterCorrection

_MOST_KEPT = 150
_MOST_USED = 40
_FIRST_SPACING = 0.03
_SPACING_GROWTH = 1.3
_SHARPER = 0.8


class CalibrationService:
    """Views that differ, from all that the camera has seen since its start, and a lens from them.

    `offer` is called on the camera's thread, `answer` on the bus's serving one. Memory is bounded:
    where the store is full, views have to differ more, and those that do not are let go.
    """

    def __init__(
        self,
        camera: str,
        targets: Sequence[Target],
        *,
        line_delay_s: float = 0.0,
        spacing: float = _FIRST_SPACING,
    ) -> None:
        """`spacing`: how far the outer corners of views are apart at first, RMS, as a share of the
        picture's width."""
        self._camera, self._targets = camera, targets
        self._shutter = ShutterCorrection(line_delay_s)
        self._first_spacing = spacing
        self._lock = threading.Lock()
        self._forget()

    def offer(
        self, faces: Sequence[FaceSighting], size: tuple[int, int], stamp_ns: int = 0
    ) -> None:
        """Keep of a picture's sightings what was not seen like this before; `size`: pixels. Of a
        rolling shutter they are as its middle row would have seen them."""
        views = views_of("", self._shutter.corrected(faces, size[1], stamp_ns), self._targets)
        with self._lock:
            if size != self._size:
                self._forget()
                self._size = size
            for view in views:
                self._count += 1
                self._keep(View(str(self._count), view.points, view.pixels, view.sigma))

    @property
    def kept(self) -> int:
        """How many views there are to calibrate from."""
        with self._lock:
            return len(self._views)

    @property
    def views(self) -> tuple[View, ...]:
        """Those views."""
        with self._lock:
            return tuple(self._views)

    def answer(self, request: bytes) -> bytes:
        """A lens from the views so far, as JSON: `intrinsics` with sigmas as in network.json,
        `camera_info` as ROS's YAML, and how it came about. `{"forget": true}` empties the store,
        `{"force": true}` asks for a lens that the views do not determine.

        Raises InputError for a request that is none, OperationError where the views do not tell
        enough.
        """
        wishes = _wishes(request, self._camera)
        if wishes.get("forget"):
            with self._lock:
                self._forget()
            return json.dumps({"kept": 0}).encode()
        with self._lock:
            views, size = list(self._views), self._size
        found = calibrate(views, size, most=_MOST_USED)
        if found.doubts and not wishes.get("force"):
            undetermined = "; ".join(str(doubt) for doubt in found.doubts)
            raise OperationError(
                f"camera {self._camera}: the views so far do not determine its lens: {undetermined}"
            )
        record = calibration_record(found, name=self._camera)
        return json.dumps({"kept": len(views), **record}).encode()

    def _forget(self) -> None:
        self._views: list[View] = []
        self._marks: list[Array] = []
        self._size = (0, 0)
        self._count = 0
        self._spacing = self._first_spacing

    def _keep(self, view: View) -> None:
        mark = outer_pixels(view).reshape(-1) / self._size[0]
        nearest, distance = self._nearest(mark)
        if distance > self._spacing:
            self._views.append(view)
            self._marks.append(mark)
        elif view.sigma < _SHARPER * self._views[nearest].sigma:
            self._views[nearest], self._marks[nearest] = view, mark
        while len(self._views) > _MOST_KEPT:
            self._thin_out()

    def _nearest(self, mark: Array) -> tuple[int, float]:
        """Which kept view is most alike, and how far its outer corners are from `mark`'s, RMS."""
        if not self._marks:
            return -1, np.inf
        distances = np.sqrt(np.mean((np.array(self._marks) - mark) ** 2, axis=1))
        nearest = int(np.argmin(distances))
        return nearest, float(distances[nearest])

    def _thin_out(self) -> None:
        self._spacing *= _SPACING_GROWTH
        views, self._views, self._marks = self._views, [], []
        for view in views:
            self._keep(view)


def _wishes(request: bytes, camera: str) -> dict[str, bool]:
    """What a request asks for; raises InputError where it is none."""
    if not request:
        return {}
    try:
        document = json.loads(request)
    except ValueError:
        document = None
    if not isinstance(document, dict) or set(document) - {"forget", "force"}:
        raise InputError(
            f'camera {camera}: calibrate takes nothing, {{"forget": true}} or {{"force": true}}; '
            "correct the request"
        )
    return {key: value is True for key, value in document.items()}
