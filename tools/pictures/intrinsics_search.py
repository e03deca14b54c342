"""The views of a target in many pictures, searched on all cores, with a bar to watch."""

import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack, closing
from multiprocessing import get_context
from pathlib import Path

import cv2
from msgspec import Struct

from trigpoint.base.errors import InputError, OperationError
from trigpoint.base.terminal import Progress
from trigpoint.edge.detector import TargetDetector, detector_for
from trigpoint.edge.lens.calibration_views import View, views_of
from trigpoint.edge.sources.opencv_log import quieten_opencv
from trigpoint.site.target import Pattern, Target

from .account import PictureAccount
from .detect import Given, Still, stills
from .unlike import greys_seen, squares_seen

# A process takes as long to start as twenty pictures to search.
_PICTURES_A_JOB = 20
# Pictures that wait for each process, at most: they are held in memory.
_AHEAD = 2
# More names than these nobody reads.
_MOST_NAMED = 5
_ARTICLES = {Pattern.CHECKERBOARD: "a", Pattern.CHARUCO: "a", Pattern.APRILGRID: "an"}


class Searched(Struct, frozen=True):
    """`count` pictures of `size` (width, height), and the views in them, in order; `misdescribed`:
    what they show that the target file describes wrongly, with what to write; `account`: what was
    left out, or scaled."""

    count: int
    size: tuple[int, int]
    views: list[View]
    misdescribed: tuple[str, ...]
    account: tuple[str, ...]


_Found = tuple[list[View], tuple[str, ...]]
"""The views in a picture, and what was seen so far that the target file describes wrongly."""


def search(
    pictures: Sequence[Given],
    targets: Sequence[Target],
    *,
    topics: Sequence[str] = (),
    jobs: int | None = None,
    is_shown: bool = True,
) -> Searched:
    """The views in pictures, folders, videos and bags (of their `topics`), the same whatever `jobs`
    is: so many pictures are searched at once, or as many as there are cores and work for.
    `is_shown`: with a word on how far it is, on a terminal.

    Raises InputError for pictures of several sizes, OperationError where none shows the target.
    """
    count, size, views, account = 0, (0, 0), list[View](), PictureAccount()
    misdescribed: dict[str, None] = {}
    sizes: dict[tuple[int, int], list[str]] = {}
    expected = _expected(pictures)
    wanted = jobs or min(os.cpu_count() or 1, max(1, expected // _PICTURES_A_JOB))
    with ExitStack() as stack:
        bar = stack.enter_context(closing(Progress("searching", expected))) if is_shown else None
        given = stills(pictures, topics, account)
        for still, (found, wrong) in _found(given, targets, wanted, stack):
            height, width = still.picture.shape
            count, size = count + 1, (width, height)
            sizes.setdefault(size, []).append(still.name)
            views += found
            misdescribed |= dict.fromkeys(wrong)
            if bar is not None:
                bar.step()
    said = account.lines()
    if len(sizes) > 1:
        raise InputError(_several(sizes))
    if not views:
        seen = squares_seen(pictures, topics) or greys_seen(pictures, topics)
        nothing = [seen, _nothing_found(count, targets)]
        raise OperationError("; ".join(filter(None, [*(misdescribed or nothing), *said])))
    return Searched(count, size, views, tuple(misdescribed), tuple(said))


def _several(sizes: dict[tuple[int, int], list[str]]) -> str:
    """How many pictures there are of each size, with names of the fewest."""
    each = sorted(sizes.items(), key=lambda item: -len(item[1]))
    counts = ", ".join(f"{len(names)} of {size[0]} × {size[1]}" for size, names in each)
    odd = [name for _, names in each[1:] for name in names]
    some = ", ".join(odd[:_MOST_NAMED]) + (", …" if len(odd) > _MOST_NAMED else "")
    return f"pictures of several sizes: {counts} ({some}); give pictures of one camera at one size"


def _expected(pictures: Sequence[Given]) -> int:
    """About how many pictures there are: of a video nobody knows."""
    folders = [one for one in pictures if isinstance(one, Path) and one.is_dir()]
    inside = sum(len(list(folder.iterdir())) for folder in folders)
    return len(pictures) - len(folders) + inside


def _nothing_found(count: int, targets: Sequence[Target]) -> str:
    faces = dict.fromkeys(
        f"{_ARTICLES[face.pattern]} {face.pattern.value} of {face.columns} × {face.rows}"
        for target in targets
        for face in target.faces
    )
    return (
        f"no view of the target was found in {count} pictures: the target file describes "
        f"{' and '.join(faces)}, and they show none; see with `trigpoint target check` whether "
        "that is the board"
    )


def _found(
    pictures: Iterator[Still], targets: Sequence[Target], jobs: int, stack: ExitStack
) -> Iterator[tuple[Still, _Found]]:
    """Every picture with its views, in order."""
    if jobs == 1:
        detector = _detector(targets)
        for still in pictures:
            yield still, _views(detector, still, targets)
        return
    pool = stack.enter_context(
        ProcessPoolExecutor(jobs, get_context("spawn"), _set_up, (tuple(targets),))
    )
    stack.callback(pool.shutdown, wait=True, cancel_futures=True)
    waiting: deque[tuple[Still, Future[_Found]]] = deque()
    for still in pictures:
        waiting.append((still, pool.submit(_searched, still)))
        if len(waiting) > _AHEAD * jobs:
            first, views = waiting.popleft()
            yield first, views.result()
    for still, views in waiting:
        yield still, views.result()


def _detector(targets: Sequence[Target]) -> TargetDetector:
    quieten_opencv()
    cv2.setNumThreads(1)  # the pictures share the cores
    return detector_for(targets)


def _views(detector: TargetDetector, still: Still, targets: Sequence[Target]) -> _Found:
    views = views_of(still.stem, detector.detect(still.picture), targets)
    return views, detector.misdescribed


_worker: tuple[TargetDetector, tuple[Target, ...]] | None = None


def _set_up(targets: tuple[Target, ...]) -> None:
    """Begin a process of the pool; an interrupt is its parent's matter."""
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = (_detector(targets), targets)


def _searched(still: Still) -> _Found:
    assert _worker is not None
    detector, targets = _worker
    return _views(detector, still, targets)
