"""The work of `look`: source → tracker → what is seen → a lens; told at every picture."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import SteadyClock, to_ns
from trigpoint.base.errors import InputError, OperationError
from trigpoint.base.words import counted
from trigpoint.edge.image.picture import eight_bits
from trigpoint.edge.lens.calibration import Calibration
from trigpoint.edge.lens.intrinsics import check_size
from trigpoint.edge.sources.frames import (
    Frame,
    FrameSource,
    Unreadable,
    open_source,
    without_password,
)
from trigpoint.edge.tracker import TargetTracker
from trigpoint.geometry import CameraModel
from trigpoint.site.config import CameraConfig
from trigpoint.site.target import Target
from trigpoint.tools.pictures.detect import LEAST_PICTURES, NOTHING_NEAR
from trigpoint.tools.pictures.intrinsics import write_lens

from .guidance import Guide
from .seen import MOST_BEND, Seen, Watch
from .shown import Shown, faces_of, facts_of, lens_of
from .taking import KnownLens, LensTaking

_STILL_APART_NS = to_ns(1.0)
"""Pictures of a folder have no time, and nothing is followed from one to the next: they are this
far apart."""
_LEAST_LIVE = 10 * LEAST_PICTURES
"""The board is still to be brought: at the usual rate this is ten seconds."""
_FINITE = ("dir", "file")
_ALL_VIEWS = "the lens of all views is being worked out"
_FROZEN = "the camera gives the same picture again and again; see whether it is on"


class Wishes(Struct, frozen=True):
    """What is looked at, and what for.

    `lens`: where it is known; `out`: where a lens is written, None where none is taken;
    `is_global`: the shutter exposes all rows at once; `ends_when_taken`: a camera, which never
    ends, is not looked at any longer then; `seconds`: how long at most, once it is open.
    """

    config: CameraConfig
    target: Target
    lens: CameraModel | None = None
    out: Path | None = None
    is_global: bool = False
    ends_when_taken: bool = False
    seconds: float | None = None


class Result(Struct, frozen=True):
    """How it ended. `lens`: the newest that was worked out; `written`: its files; `missing`: why
    there are none where a lens was wanted; `hints`: what the target file has wrong, and what was
    left out; `over`: how it ended, in words."""

    pictures: int
    with_target: int
    size: tuple[int, int]
    views: int
    lens: Calibration | None
    written: tuple[Path, ...]
    missing: str
    hints: tuple[str, ...]
    over: str


Tell = Callable[[Shown, np.ndarray], None]
"""Takes a moment and its picture, of 8 bits."""


class Look:
    """One source, looked at by `run` on one thread until its end or `stop`."""

    def __init__(self, wishes: Wishes, tell: Tell) -> None:
        self._wishes, self._tell = wishes, tell
        self._stopping = threading.Event()
        self._scheme = wishes.config.scheme
        self._tracker = TargetTracker([wishes.target], rests=False)
        self._watch = Watch()
        self._lens = KnownLens(wishes.target, wishes.lens)
        self._taking = LensTaking([wishes.target])
        self._guide = Guide(wishes.config)
        self._pictures = self._with_target = 0
        self._size = (0, 0)
        # How many were left out for their size, and the first of them in words.
        self._left_out, self._odd = 0, ""
        self._written: tuple[Path, ...] = ()
        self._lack = "no picture came; see whether it is on"
        self._last: tuple[Shown, np.ndarray] | None = None

    @property
    def name(self) -> str:
        """The source, without a password."""
        url = self._wishes.config.source
        return url if self._scheme in _FINITE else without_password(url)

    def stop(self) -> None:
        """Ask it to end. Any thread."""
        self._stopping.set()

    @property
    def is_stopped(self) -> bool:
        """Whether `stop` was called: else the source has ended."""
        return self._stopping.is_set()

    def wait(self) -> None:
        """Wait for `stop`."""
        self._stopping.wait()

    def run(self) -> Result:
        """Look; raises what the source raises, InputError for pictures of another size than the
        lens or those before (of a folder, where they are half or more: fewer are left out), and
        OperationError where no picture came."""
        try:
            with self._opened() as source:
                for frame in source.frames(self._stopping):
                    if isinstance(frame, Unreadable):
                        self._lack = f"no picture came that can be read; {frame.reason}"
                    elif frame is not None:
                        self._take(frame)
            return self._ended()
        finally:
            self._taking.close()

    @contextmanager
    def _opened(self) -> Iterator[FrameSource]:
        config = self._wishes.config
        source = open_source(config.source, config, clock=SteadyClock(), directory=Path())
        timer = threading.Timer(self._wishes.seconds or 0.0, self.stop)
        try:
            self._lens.hear(source.intrinsics)
            if self._wishes.seconds is not None:
                timer.start()
            yield source
        finally:
            timer.cancel()
            source.close()

    def _take(self, frame: Frame) -> None:
        picture = eight_bits(frame.picture)
        if not self._is_of_one_size(picture, frame.name):
            return
        self._pictures += 1
        is_still = self._scheme == "dir"
        stamp_ns = self._pictures * _STILL_APART_NS if is_still else frame.captured_ns
        self._tracker.detect(picture, stamp_ns)
        seen = self._watch.seen(self._tracker.located, stamp_ns, self._size[1])
        self._with_target += bool(seen)
        usable = [one for one in seen if self._is_usable(one)]
        if self._wishes.out is not None:
            self._learn(usable)
        self._last = self._shown(frame, seen, is_held=len(usable) == len(seen)), picture
        self._tell(*self._last)

    def _is_of_one_size(self, picture: np.ndarray, name: str) -> bool:
        """Whether a picture is used: of a folder, those of another size than the first are left
        out. Raises InputError."""
        height, width = picture.shape[:2]
        if self._pictures == 0:
            self._size = (width, height)
            if self._wishes.lens is not None:
                config, lens = self._wishes.config, self._wishes.lens
                check_size(self.name, config, lens, picture.shape)
        if (width, height) == self._size:
            return True
        self._odd = self._odd or f"{name or f'picture {self._pictures + 1}'} is {width} × {height}"
        self._left_out += 1
        if self._scheme != "dir":
            raise self._mixed()
        return False

    def _mixed(self) -> InputError:
        return InputError(
            f"{self._odd}, those before were {self._size[0]} × {self._size[1]}; give "
            "pictures of one camera at one size"
        )

    @property
    def _odd_sizes(self) -> list[str]:
        """What is said of pictures that were left out for their size."""
        if not self._left_out:
            return []
        size = f"{self._size[0]} × {self._size[1]}"
        count = counted(self._left_out, "picture")
        more = ", …" if self._left_out > 1 else ""
        return [f"{count} left out, not of the size of the first ({size}): {self._odd}{more}"]

    def _is_usable(self, seen: Seen) -> bool:
        """Whether a rolling shutter bends a face by no more than a lens bears."""
        return self._wishes.is_global or seen.bend_px <= MOST_BEND * float(np.hypot(*self._size))

    def _learn(self, usable: list[Seen]) -> None:
        """Keep views, and take the lens once they tell it."""
        self._taking.offer([one.sighting for one in usable], self._size)
        if self._taking.step() and self._taking.good is not None and not self._written:
            self._write(self._taking.good)
            if self._wishes.ends_when_taken and self._scheme not in _FINITE:
                self.stop()

    def _write(self, found: Calibration) -> None:
        assert self._wishes.out is not None
        self._written = tuple(write_lens(self._wishes.out, found, self._pictures))
        self._lens.take(found.camera, str(self._wishes.out))

    def _shown(self, frame: Frame, seen: tuple[Seen, ...], *, is_held: bool) -> Shown:
        taking = self._taking
        views, found = taking.views, taking.found
        is_taken = self._wishes.out is not None
        self._guide.look(views, self._size, found if is_taken else None)
        step = self._guide.step(
            is_seen=bool(seen),
            is_held=is_held,
            is_taken=is_taken,
            is_done=bool(self._written),
            is_working=taking.is_working,
        )
        return Shown(
            number=self._pictures,
            stamp=str(frame.captured_ns),
            width=self._size[0],
            height=self._size[1],
            faces=faces_of(seen),
            facts=[*facts_of(seen), ("lens", self._lens.words(seen[0].sighting if seen else None))],
            hints=self._hints(is_frozen=frame.is_frozen),
            advice=step.advice,
            next=step.name,
            needs=self._guide.needs if is_taken else (),
            coverage=self._guide.coverage,
            views=len(views),
            is_working=taking.is_working,
            lens=found and lens_of(found),
            trouble=taking.trouble,
            written=str(self._wishes.out) if self._written else "",
        )

    def _hints(self, *, is_frozen: bool) -> list[str]:
        hints = [*self._tracker.misdescribed, *([_FROZEN] if is_frozen else [])]
        least = LEAST_PICTURES if self._scheme == "dir" else _LEAST_LIVE
        is_unseen = not self._with_target and self._pictures >= least
        return [*hints, *([NOTHING_NEAR] if is_unseen and not hints else [])]

    def _ended(self) -> Result:
        """Take what there is: where the source has ended, the lens of all views."""
        if self._last is None:
            raise OperationError(f"{self.name}: {self._lack}")
        if self._left_out >= self._pictures:
            raise self._mixed()
        missing = ""
        if self._wishes.out is not None:
            shown, picture = self._last
            self._tell(replace(shown, advice=_ALL_VIEWS, next="", is_working=True), picture)
            self._taking.finish()
            best = self._taking.best
            if best is not None:
                self._write(best)
            missing = "" if best is not None else self._missing()
        shown, picture = self._last
        over = self._over(shown, missing)
        self._tell(over, picture)
        found, hints = self._taking.found, (*self._tracker.misdescribed, *self._odd_sizes)
        counts = (self._pictures, self._with_target, self._size, len(self._taking.views))
        return Result(*counts, found, self._written, missing, hints, over.over)

    def _missing(self) -> str:
        if not self._with_target:
            return "; ".join(self._tracker.misdescribed) or "the board was not seen"
        seen = f"the board was seen in {self._with_target} of {self._pictures} pictures"
        return f"{seen}; {self._taking.missing}"

    def _over(self, shown: Shown, missing: str) -> Shown:
        found = self._taking.found
        words = f"the lens is in {self._wishes.out}" if self._written else missing
        return replace(
            shown,
            hints=[*shown.hints, *self._odd_sizes],
            lens=found and lens_of(found),
            written=str(self._wishes.out) if self._written else "",
            advice="",
            next="",
            is_working=False,
            over=f"it has ended; {words}" if words else "it has ended",
        )
