"""How much is looked for in one picture in place of the file's boards."""

from functools import partial

import cv2
import numpy as np
import pytest

from trigpoint.edge.markers import misdescribed
from trigpoint.edge.markers.misdescribed import MisdescribedBoards
from trigpoint.edge.markers.other_boards import readings
from trigpoint.edge.markers.quads import QuadFinder
from trigpoint.edge.registration.appearance import Appearance
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import NOWHERE, Face, Pattern

BOARD = Face(*(0, Pattern.CHARUCO, 5, 7, 0.036, *NOWHERE), marker=0.018, dictionary="DICT_6X6_250")
SIDE, CELL = 16, 24


@pytest.fixture(name="tried")
def _tried(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What was looked for, in order."""
    tried = list[object]()
    best = misdescribed._Scene.best  # pyright: ignore[reportPrivateUsage]

    def recorded(scene: object, reading: object) -> object:
        tried.append(reading)
        return best(scene, reading)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(misdescribed._Scene, "best", recorded)  # pyright: ignore
    return tried


def wall() -> np.ndarray:
    """A picture full of markers of the board's dictionary, in no board's order."""
    picture = np.full((480, 640), 230, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    numbers = np.random.default_rng(3).permutation(250)
    places = [(x, y) for y in range(8, 456, CELL) for x in range(8, 616, CELL)]
    for number, (x, y) in enumerate(places):
        marker = cv2.aruco.generateImageMarker(dictionary, int(numbers[number % 250]), SIDE)
        picture[y : y + SIDE, x : x + SIDE] = marker
    return picture


def squares(count: int) -> dict[tuple[bool, bool], Array]:
    """So many dark quadrilaterals, seen in a picture itself."""
    square = np.array([[0, 0], [9, 0], [9, 9], [0, 9]], float)
    return {(False, False): np.tile(square + 99, (count, 1, 1))}


def test_a_wall_of_markers_is_looked_at_over_several_pictures(tried: list[object]) -> None:
    boards, picture = MisdescribedBoards([Appearance(BOARD, "box", 0)], [BOARD]), wall()
    boards.look(picture, set())
    first = list(tried)
    for _ in range(20):
        boards.look(picture, set())
    assert len(first) <= len(set(tried)) // 2
    assert set(tried[: len(first)]) != set(tried)


def test_no_board_is_begun_when_the_time_is_over(tried: list[object]) -> None:
    boards = MisdescribedBoards([Appearance(BOARD, "box", 0)], [BOARD])
    picture = np.full((480, 640), 230, np.uint8)
    boards.look(picture, set(), lambda: len(tried) >= 2)
    assert len(tried) == 2
    boards.look(picture, set(), lambda: len(tried) >= 4)
    assert len(set(tried)) == 4


def _has_grown(tried: list[object], most: int) -> bool:
    return len(tried) >= most


def test_nothing_vague_is_said_before_every_board_was_looked_for(tried: list[object]) -> None:
    look = Appearance(BOARD, "box", 0)
    boards, picture = MisdescribedBoards([look], [BOARD]), np.full((480, 640), 230, np.uint8)
    count = len(list(readings((look,))))
    while len(tried) + 5 < count:
        boards.look(picture, {look}, partial(_has_grown, tried, len(tried) + 5))
        assert boards.lines == {}
    boards.look(picture, {look})
    assert "compare columns" in boards.lines[look]
    assert boards.refused == {look}  # as is said


def test_boards_are_looked_for_again_when_something_comes_in_but_not_for_ever(
    tried: list[object],
) -> None:
    look = Appearance(BOARD, "box", 0)
    boards, picture = MisdescribedBoards([look], [BOARD]), np.full((480, 640), 230, np.uint8)
    for _ in range(100):
        boards.look(picture, set(), quads=squares(2))
    before = len(tried)
    for _ in range(10):
        boards.look(picture, set(), quads=squares(20))
    assert set(tried[before:]) == set(readings((look,)))
    for _ in range(100):
        boards.look(picture, set(), quads=squares(20))
    assert len(tried) - before < 10 * len(set(tried))


@pytest.mark.parametrize(("found", "is_said"), [(0, True), (20, True), (40, False)])
def test_a_board_that_is_contradicted_now_and_then_is_no_other_one(
    found: int, is_said: bool
) -> None:
    look = Appearance(BOARD, "box", 0)
    boards, picture = MisdescribedBoards([look], [BOARD]), np.full((480, 640), 230, np.uint8)
    for _ in range(found):
        boards.confirm(look)
    for _ in range(3):
        boards.look(picture, {look})
    assert (look in boards.lines, boards.refused == {look}) == (is_said, is_said)


def test_a_board_contradicted_by_accident_is_used_again_once_seen_for_long() -> None:
    look = Appearance(BOARD, "box", 0)
    boards, picture = MisdescribedBoards([look], [BOARD]), np.full((480, 640), 230, np.uint8)
    said = list[bool]()
    for found, denied in ((25, 3), (5, 0), (0, 1)):
        for _ in range(found):
            boards.confirm(look)
        for _ in range(denied):
            boards.look(picture, {look})
        assert (look in boards.lines) is (boards.refused == {look})
        said.append(look in boards.lines)
    assert said == [True, False, True]


def test_no_quadrilaterals_are_looked_for_twice_in_a_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked = list[bool]()
    find = QuadFinder.find

    def recorded(finder: QuadFinder, grey: np.ndarray) -> Array:
        looked.append(finder.parts_touching)
        return find(finder, grey)

    monkeypatch.setattr(QuadFinder, "find", recorded)
    boards = MisdescribedBoards([Appearance(BOARD, "box", 0)], [BOARD])
    boards.look(np.full((480, 640), 230, np.uint8), set(), quads=squares(2))
    assert looked == [True, True, False]  # in the picture, in its negative, in no mirror image
