"""What sightings are off, in the pictures: residuals, and in red what contradicts the poses."""

from collections import deque
from collections.abc import Sequence

import rerun as rr

from trigpoint.base.clock import to_ns

from . import style
from .columns import Columns
from .hull import outline
from .log import LogLine
from .pixel_residuals import Residual

_KEPT = 64
_QUIET_NS = to_ns(5.0)


class VerdictScene:
    """One camera's residuals: a line at each corner, a plot, a red outline and a line in the log
    where a sighting contradicts where the robot and the camera are said to be."""

    def __init__(self, camera: str, columns: Columns, log: LogLine) -> None:
        self._camera, self._columns, self._log = camera, columns, log
        self._picture = style.picture_path(camera)
        self._recent: deque[tuple[int, list[Residual]]] = deque(maxlen=_KEPT)
        self._said_ns = -_QUIET_NS
        self._is_drawn = False

    def add(self, stamp_ns: int, residuals: Sequence[Residual | None]) -> None:
        """Take those of one picture; None: nobody can say where this face should be."""
        known = [one for one in residuals if one is not None]
        if not known:
            return
        self._recent.append((stamp_ns, known))
        entity = f"{style.RESIDUALS}/{self._camera}"
        off_px = max(one.off_px for one in known)
        self._columns.row(entity, stamp_ns, rr.Scalars, scalars=[off_px])
        worst = max(known, key=lambda one: one.off_sigmas)
        if worst.contradicts and stamp_ns - self._said_ns >= _QUIET_NS:
            self._said_ns = stamp_ns
            self._log(stamp_ns, "WARN", f"{self._camera}: a sighting {_reason(worst)}")

    def draw(self, stamp_ns: int) -> None:
        """Draw those of the picture of this stamp, or wipe what was drawn before."""
        known = next((found for at_ns, found in self._recent if at_ns == stamp_ns), [])
        if known or self._is_drawn:
            self._is_drawn = bool(known)
            self._draw_lines(stamp_ns, [one for one in known if not one.contradicts])
            self._draw_rejected(stamp_ns, [one for one in known if one.contradicts])

    def _draw_lines(self, stamp_ns: int, residuals: Sequence[Residual]) -> None:
        """From each corner towards where it is expected, larger by what the legend says."""
        strips = [
            [seen, seen + style.RESIDUALS_DRAWN * (expected - seen)]
            for one in residuals
            for seen, expected in zip(one.seen, one.expected, strict=True)
        ]
        self._columns.row(
            f"{self._picture}/residuals",
            stamp_ns,
            rr.LineStrips2D,
            strips=strips,
            colors=[style.RESIDUAL] * len(strips),
            radii=[style.ui_points(1.0)] * len(strips),
        )

    def _draw_rejected(self, stamp_ns: int, residuals: Sequence[Residual]) -> None:
        """What was seen and where it was expected, with the reason between."""
        strips = [outline(points) for one in residuals for points in (one.seen, one.expected)]
        self._columns.row(
            f"{self._picture}/rejected",
            stamp_ns,
            rr.LineStrips2D,
            strips=strips,
            colors=[style.REJECTED] * len(strips),
            radii=[style.ui_points(2.5), style.ui_points(1.0)] * len(residuals),
        )
        self._columns.row(
            f"{self._picture}/reason",
            stamp_ns,
            rr.Points2D,
            positions=[one.expected.mean(axis=0) for one in residuals],
            colors=[style.REJECTED] * len(residuals),
            radii=[style.ui_points(0.0)] * len(residuals),
            labels=[_reason(one) for one in residuals],
        )


def _reason(one: Residual) -> str:
    return f"is {one.off_px:.0f} px ({one.off_sigmas:.0f} sigmas) off where it should be"
