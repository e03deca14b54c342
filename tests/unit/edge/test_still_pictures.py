"""A picture in which nothing was found, and nothing changes, is searched occasionally."""

from typing import Any

import numpy as np
import pytest
from support.pictures.boards import (
    aprilgrid,
    charuco,
    checkerboard,
    picture_of,
    placed,
    plain_picture,
    target_of,
)

from trigpoint.contract.messages import FaceSighting
from trigpoint.edge.image.stillness import Stillness
from trigpoint.edge.tracker import SEARCH_EVERY_NS, TargetTracker
from trigpoint.site.target import Face

STEP_NS = 100_000_000
FACES = [checkerboard(8, 5), charuco(), aprilgrid()]


class Camera:
    """A tracker, and when it searched its pictures, which come at 10 Hz."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *faces: Face) -> None:
        self.tracker, self._next = TargetTracker([target_of(*faces)]), 0
        self.searched: list[int] = []
        searched = TargetTracker._searched

        def noted(*given: Any) -> Any:
            self.searched.append(self._next)
            return searched(*given)

        monkeypatch.setattr(TargetTracker, "_searched", noted)

    def sees(self, picture: np.ndarray) -> tuple[FaceSighting, ...]:
        """What is found in one more picture."""
        self._next += 1
        return self.tracker.detect(picture, self._next * STEP_NS)

    def rests(self, count: int, *, level: float = 110.0) -> None:
        """So many pictures of an empty room, noisy ones."""
        for _ in range(count):
            assert self.sees(plain_picture(noise=3.0, level=level, seed=self._next)) == ()


def test_empty_room_is_searched_twice_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(monkeypatch, *FACES[:1])
    camera.rests(31)
    assert camera.searched == [*range(1, 12), 16, 21, 26, 31]


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.pattern.value)
def test_face_that_comes_into_an_empty_room_is_found_at_once(
    face: Face, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(monkeypatch, face)
    camera.rests(22)
    far = placed(face, distance=1.4 if face.marker else 2.2, tilt_deg=10)
    faint = 110 + 0.15 * (picture_of([far], noise=10.0).astype(float) - 110)
    assert len(camera.sees(faint.round().astype(np.uint8))) == 1


def test_room_that_has_come_to_rest_is_searched_for_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera = Camera(monkeypatch, *FACES[:1])
    camera.rests(22)
    camera.rests(20, level=125.0)
    assert camera.searched[-12:] == [*range(23, 33), 37, 42]


def test_parked_face_is_found_though_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever hid it from the first searches."""
    camera = Camera(monkeypatch, *FACES[:1])
    (finder,) = camera.tracker._finders.values()
    located = finder.locate
    monkeypatch.setattr(finder, "locate", lambda *_: [])
    parked = picture_of([placed(FACES[0], distance=0.9)], noise=2.0)
    for _ in range(22):
        assert camera.sees(parked) == ()
    monkeypatch.setattr(finder, "locate", located)
    assert any(camera.sees(parked) for _ in range(SEARCH_EVERY_NS // STEP_NS))


def test_room_that_a_face_has_left_is_searched_though_it_looks_as_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera = Camera(monkeypatch, *FACES[:1])
    camera.rests(22)
    for x in (0.0, 0.02):
        assert camera.sees(picture_of([placed(FACES[0], distance=0.9, x=x)], noise=2.0))
    camera.rests(12)
    assert camera.searched[-12:] == [*range(25, 37)]


def test_other_sizes_and_times_are_no_stillness() -> None:
    stillness = Stillness()
    assert not stillness.lasts(np.zeros((3, 3), np.uint8), 0)
    picture = np.zeros((50, 70), np.uint8)
    stamps_s = (10, 11, 5, 6)
    lasts = [stillness.lasts(picture, stamp_s * 1_000_000_000) for stamp_s in stamps_s]
    assert lasts == [False, True, False, True]
    assert not stillness.lasts(picture[:40], 7_000_000_000)
