"""Reports the target to people: first seen, lost for long, seen again, summed up."""

import logging

from trigpoint.base.clock import Clock, to_ns, to_seconds
from trigpoint.base.words import counted

_log = logging.getLogger(__name__)

_LOST_NS = to_ns(30.0)
"""A robot drives out of a camera's view and back all the time; this long it is worth a line."""


class TargetWatch:
    """Used by the camera's thread."""

    def __init__(self, camera: str, clock: Clock) -> None:
        self._camera, self._clock = camera, clock
        self._pictures = self._with_target = self._faces = 0
        self._seen_ns: int | None = None
        self._is_lost = False

    def saw(self, faces: int) -> None:
        """Note how many faces were found in one more picture."""
        now_ns = self._clock.elapsed_ns()
        self._pictures += 1
        if faces:
            self._with_target += 1
            self._faces += faces
            self._see(now_ns, faces)
        elif self._seen_ns is not None and not self._is_lost and now_ns - self._seen_ns > _LOST_NS:
            self._is_lost = True
            _log.info(
                "camera %s has not seen the target for %.0f s", self._camera, to_seconds(_LOST_NS)
            )

    def _see(self, now_ns: int, faces: int) -> None:
        if self._seen_ns is None:
            _log.info(
                "camera %s sees the target: %s, in picture %d",
                self._camera,
                counted(faces, "face"),
                self._pictures,
            )
        elif self._is_lost:
            away_s = to_seconds(now_ns - self._seen_ns)
            _log.info("camera %s sees the target again, after %.0f s", self._camera, away_s)
        self._seen_ns, self._is_lost = now_ns, False

    def sum_up(self, *, lost: int) -> None:
        """Report the totals; `lost`: pictures that could not be used."""
        _log.info(
            "camera %s: %s, %d with the target, %s; %d lost",
            self._camera,
            counted(self._pictures, "picture"),
            self._with_target,
            counted(self._faces, "face"),
            lost,
        )
