"""Takes a lens from what is seen: keeps views that differ, and works on them beside the camera."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

from trigpoint.base.ending import ENDING
from trigpoint.base.errors import OperationError
from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.lens.calibration import FEWEST_VIEWS, Calibration, calibrate
from trigpoint.edge.lens.calibration_fit import place
from trigpoint.edge.lens.calibration_looks import SAME_SHARE
from trigpoint.edge.lens.calibration_service import CalibrationService
from trigpoint.edge.lens.calibration_text import THINLY_COVERED, covered_share, has_good_focal
from trigpoint.edge.lens.calibration_views import View, views_of
from trigpoint.geometry import CameraModel
from trigpoint.site.target import Target

FEWEST = 6
"""From so many views on a lens is tried: four are the least that can be held against each other."""
_MORE = 0.25
"""It is tried again when this share of the views is new."""
_MOST_LIVE = 40
"""Views of a trial beside the camera; at the end all are used."""
_LOOK_S = 0.2
_LONGEST_S = 30.0


class LensTaking:
    """For the camera's thread; a trial is worked out on one of its own, one at a time.

    `found`: the newest lens, `trouble`: why the newest trial led to none; `good`: the newest lens
    that is determined, all over the picture, its focal length to half a percent.
    """

    def __init__(self, targets: Sequence[Target]) -> None:
        self._store = CalibrationService("look", targets, spacing=SAME_SHARE)
        self._size = (0, 0)
        self._tried: frozenset[str] = frozenset()
        self._pool = ThreadPoolExecutor(1, "works out the lens")
        self._trial: Future[Calibration] | None = None
        self.found: Calibration | None = None
        self.good: Calibration | None = None
        self.trouble = ""

    @property
    def views(self) -> tuple[View, ...]:
        return self._store.views

    @property
    def best(self) -> Calibration | None:
        """The lens that may be written: all that it has is determined."""
        is_sound = self.found is not None and not self.found.doubts
        return self.found if is_sound else self.good

    @property
    def missing(self) -> str:
        if self.found is not None and self.found.doubts:
            return "; ".join(str(doubt) for doubt in self.found.doubts)
        return self.trouble or f"{len(self.views)} different views are too few for a lens"

    @property
    def is_working(self) -> bool:
        return self._trial is not None

    def offer(self, faces: Sequence[FaceSighting], size: tuple[int, int]) -> None:
        """Keep what was not seen like this before."""
        self._size = size
        self._store.offer(faces, size)

    def step(self) -> bool:
        """Take up a trial that is done, and begin one where enough is new; whether one was done."""
        is_done = self._trial is not None and self._trial.done()
        if is_done:
            self._take_up()
        views = self.views
        names = frozenset(view.name for view in views)
        is_more = len(names - self._tried) >= max(1, _MORE * len(self._tried))
        if self._trial is None and len(views) >= FEWEST and is_more:
            self._tried = names
            self._trial = self._pool.submit(calibrate, views, self._size, most=_MOST_LIVE)
        return is_done

    def finish(self) -> None:
        """Work out the lens of all views, where some are not in it yet."""
        self._wait()
        if (
            len(self.views) < FEWEST_VIEWS
            or ENDING.is_asked
            or frozenset(view.name for view in self.views) == self._used
        ):
            return
        self._trial = self._pool.submit(calibrate, self.views, self._size)
        self._wait()

    def close(self) -> None:
        """Let a trial go that is not done in time."""
        if self._trial is not None:
            wait([self._trial], min(_LONGEST_S, ENDING.left_s(0.5)))
        self._pool.shutdown(wait=False, cancel_futures=True)

    @property
    def _used(self) -> frozenset[str]:
        """The views that the newest lens is of, or has rejected."""
        if self.found is None:
            return frozenset()
        rejected = {view.name for view in self.found.rejected}
        return frozenset(view.name for view in self.found.used) | rejected

    def _wait(self) -> None:
        """Wait for a trial, but not when the program is told to stop."""
        while self._trial is not None and not ENDING.is_asked:
            if wait([self._trial], _LOOK_S).done:
                self._take_up()

    def _take_up(self) -> None:
        assert self._trial is not None
        trial, self._trial = self._trial, None
        try:
            self.found, self.trouble = trial.result(), ""
        except OperationError as reason:
            self.trouble = str(reason)
            return
        is_covered = covered_share(self.found) >= THINLY_COVERED
        if not self.found.doubts and is_covered and has_good_focal(self.found):
            self.good = self.found


class KnownLens:
    """Which lens is known of the camera, by whom, and how well it fits. For one thread; `given`:
    the lens that the user gave."""

    def __init__(self, target: Target, given: CameraModel | None) -> None:
        self._target, self._camera = target, given
        self._by = "given" if given is not None else ""

    def hear(self, own: CameraModel | None) -> None:
        """Take the source's own lens where none was given."""
        if self._camera is None and own is not None:
            self._camera, self._by = own, "by the source"

    def take(self, camera: CameraModel, where: str) -> None:
        """Take the one that was worked out, and written there."""
        self._camera, self._by = camera, f"in {where}"

    def words(self, seen: FaceSighting | None) -> str:
        """Whether it is known, and by how much it misses the corners that are seen."""
        if self._camera is None:
            return "not known yet"
        views = [] if seen is None else views_of("", [seen], [self._target])
        placed = place(self._camera, views[0]) if views else None
        fits = f"; it fits this picture to {placed.rms_px:.2f} px a corner" if placed else ""
        return f"known, {self._by}{fits}"
