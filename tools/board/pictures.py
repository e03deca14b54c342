"""A camera's pictures and sightings, which leave its node only while a page has them open."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.base.errors import InputError, MessageError, OperationError
from trigpoint.bus.bus import Bus, Subscription
from trigpoint.contract import cdr
from trigpoint.contract.messages import FaceSighting, Picture, Sightings
from trigpoint.contract.topics import IMAGE, SIGHTINGS, Topic

MOST_WATCHED = 6
_IDLE_S = 5.0
_WAIT_S = 2.0
_KEPT = 4
_SIGHTINGS = 64
_POLL_S = 0.05


class _Watch(Struct):
    pictures: Subscription
    sightings: Subscription
    asked_s: float = 0.0
    shown: deque[Picture] = field(default_factory=lambda: deque(maxlen=_KEPT))
    seen: deque[Sightings] = field(default_factory=lambda: deque(maxlen=_SIGHTINGS))

    def drain(self) -> None:
        self.shown.extend(_decoded(IMAGE, self.pictures))
        self.seen.extend(_decoded(SIGHTINGS, self.sightings))

    def close(self) -> None:
        self.pictures.close()
        self.sightings.close()


class Pictures:
    """Subscribes for whoever asks, and withdraws five seconds after the last one did. Any thread;
    `bus`: gives the open session, None while there is none."""

    def __init__(self, bus: Callable[[], Bus | None], site: str, cameras: frozenset[str]) -> None:
        self._bus, self._site, self._cameras = bus, site, cameras
        self._watches: dict[str, _Watch] = {}
        self._lock = threading.Lock()

    def newest(self, camera: str, after_ns: int) -> tuple[Picture, tuple[FaceSighting, ...]]:
        """A picture later than `after_ns` with the faces found in it; waits two seconds for one.

        Raises InputError for an unknown camera, OperationError where none comes.
        """
        deadline = time.monotonic() + _WAIT_S
        while True:
            with self._lock:
                watch = self._watch(camera)
                watch.drain()
                found = self._found(watch, after_ns)
            if found is not None:
                return found
            if time.monotonic() > deadline:
                raise OperationError(f"no picture of {camera} comes; is its agent running?")
            time.sleep(_POLL_S)

    def jpeg(self, camera: str, stamp_ns: int) -> bytes | None:
        """One of the last pictures' bytes; None where it is not kept any more."""
        with self._lock:
            watch = self._watches.get(camera)
            shown = [] if watch is None else list(watch.shown)
        return next((one.data for one in shown if one.stamp_ns == stamp_ns), None)

    def end_idle(self) -> None:
        """Withdraw what nobody asked for lately."""
        now_s = time.monotonic()
        with self._lock:
            for camera in [c for c, w in self._watches.items() if now_s - w.asked_s > _IDLE_S]:
                self._watches.pop(camera).close()

    def close(self) -> None:
        with self._lock:
            while self._watches:
                self._watches.popitem()[1].close()

    def _watch(self, camera: str) -> _Watch:
        if camera not in self._cameras:
            raise InputError(f"the site file has no camera «{camera}»")
        watch = self._watches.get(camera)
        if watch is None:
            bus = self._bus()
            if bus is None:
                raise OperationError("the site's bus is not reached yet; wait a moment")
            if len(self._watches) >= MOST_WATCHED:
                raise OperationError(f"{MOST_WATCHED} cameras are looked at already; close one")
            pictures = bus.subscribe(IMAGE, IMAGE.key(self._site, camera))
            new = replace(SIGHTINGS, cache=0)  # of what was before no picture is shown
            sightings = bus.subscribe(new, SIGHTINGS.key(self._site, camera))
            watch = self._watches[camera] = _Watch(pictures, sightings)
        watch.asked_s = time.monotonic()
        return watch

    def _found(
        self, watch: _Watch, after_ns: int
    ) -> tuple[Picture, tuple[FaceSighting, ...]] | None:
        """The newest picture whose sightings are there too; where they do not come, or come late,
        the last but one without."""
        later = [picture for picture in watch.shown if picture.stamp_ns > after_ns]
        faces = {one.stamp_ns: one.faces for one in watch.seen}
        both = [picture for picture in later if picture.stamp_ns in faces]
        if both:
            return both[-1], faces[both[-1].stamp_ns]
        return (later[-2], ()) if len(later) > 1 else None


def _decoded(topic: Topic, subscription: Subscription) -> Iterator[Any]:
    """The messages; every node counts and names what does not decode already."""
    while (sample := subscription.take(0.0)) is not None:
        with suppress(MessageError):
            yield cdr.decode(topic.type_name, sample.payload)
