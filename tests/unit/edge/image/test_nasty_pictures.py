"""Pictures that no camera should take: nothing is found in them, and the work stays bounded."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from support.pictures.boards import aprilgrid, charuco, checkerboard, target_of

from benchmarks.pictures.empty import empty_picture
from benchmarks.pictures.nasty import nasty_pictures
from trigpoint.base.clock import ManualClock
from trigpoint.base.errors import InputError
from trigpoint.edge.boards import detector_checkerboard, grid
from trigpoint.edge.boards.tuning import TUNING
from trigpoint.edge.detector import detector_for
from trigpoint.edge.markers import marked_board, marked_search, quads
from trigpoint.edge.markers.detector_charuco import CharucoDetector
from trigpoint.edge.registration.appearance import appearances
from trigpoint.edge.tracker import TargetTracker

TARGET = target_of(checkerboard(), charuco(number=1), aprilgrid(number=2))
COSTLY: list[tuple[object, str]] = [
    (grid.GridSearch, "take"),
    (grid.GridSearch, "grids"),
    (grid.GridSearch, "grown"),
    (detector_checkerboard, "_measured"),
    (detector_checkerboard, "measured"),
    (marked_board.MarkedBoard, "locate"),
    (marked_board, "measured"),
    (quads.QuadFinder, "find"),
    (marked_search, "group_markers"),
]


@pytest.fixture(scope="module")
def nasty() -> dict[str, np.ndarray]:
    return dict(nasty_pictures((checkerboard(), charuco(number=1))))


@pytest.mark.parametrize("number", range(16))
def test_nothing_is_found_where_nothing_is(number: int) -> None:
    assert detector_for([TARGET]).detect(empty_picture(number)) == ()


def test_work_is_bounded_whatever_the_picture(
    nasty: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    done = counted(monkeypatch, COSTLY)
    detector = detector_for([TARGET])
    for name, picture in nasty.items():
        done.clear()
        detector.detect(picture)
        looks = 2  # at the whole size, and at half
        assert done["grown"] <= looks * TUNING.most_grown, name
        assert done["_measured"] <= looks * TUNING.most_grids, name
        # Two marked faces are looked for.
        assert done["locate"] <= 2 * marked_search.MOST_REFUSED + 2, name
        assert done["group_markers"] <= 2 + 1, name  # tags also on their heads


def test_no_picture_takes_longer_than_its_time(
    nasty: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where every costly step takes 15 ms; the tracker meets each picture twice, so that what it
    found is followed."""
    clock = ManualClock()
    counted(monkeypatch, COSTLY, lambda: clock.advance(0.015))
    for name, picture in nasty.items():
        tracker = TargetTracker([TARGET], budget_s=0.1, clock=clock)
        for stamp_ns in (100_000_000, 200_000_000):
            began_ns = clock.elapsed_ns()
            tracker.detect(picture, stamp_ns)
            assert clock.elapsed_ns() - began_ns <= 100_000_000, name


def test_corners_are_no_more_than_the_bound(nasty: dict[str, np.ndarray]) -> None:
    search = grid.GridSearch()
    for picture in nasty.values():
        assert search.take(picture) <= grid.MOST_CORNERS
        assert sum(map(len, search.grids())) <= grid.MOST_CORNERS


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((0, 10), np.uint8),
        np.zeros((10, 0, 3), np.uint8),
        np.zeros((20, 20), np.bool_),
        np.zeros((20, 20, 5), np.uint8),
        np.zeros(20, np.uint8),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(picture: np.ndarray) -> None:
    with pytest.raises(InputError) as raised:
        TargetTracker([TARGET]).detect(picture, 1)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (700, 1), (2, 2), (17, 3, 3)])
def test_smallest_pictures_show_nothing(shape: tuple[int, ...]) -> None:
    assert TargetTracker([TARGET]).detect(np.full(shape, 90, np.uint8), 1) == ()


def counted(
    monkeypatch: pytest.MonkeyPatch,
    names: list[tuple[object, str]],
    then: Callable[[], None] = lambda: None,
) -> Counter[str]:
    """How often each function is called from now on; `then` is done at every call."""
    calls: Counter[str] = Counter()

    def wrapped(name: str, function: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **named: object) -> object:
            calls[name] += 1
            then()
            return function(*arguments, **named)

        return call

    for owner, name in names:
        monkeypatch.setattr(owner, name, wrapped(name, getattr(owner, name)))
    return calls


def test_boards_that_are_left_when_the_time_is_up_are_not_tried(
    nasty: dict[str, np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[object] = []

    def group(*arguments: object) -> list[object]:
        tried.append(arguments)
        return []

    monkeypatch.setattr(marked_search, "group_markers", group)
    looks = appearances([target_of(charuco(number=1), charuco(number=2, first=20))])
    CharucoDetector(looks).locate(nasty["markers of 24 px"], lambda: bool(tried))
    assert len(tried) == 1
