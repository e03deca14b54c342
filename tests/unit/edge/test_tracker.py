"""Faces are followed from picture to picture, and found again where they come from anew."""

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
    true_pixels,
)

from trigpoint.base.clock import ManualClock
from trigpoint.edge import tracker as tracker_module
from trigpoint.edge.boards import detector_checkerboard
from trigpoint.edge.detector import finders_for
from trigpoint.edge.image.time_limit import never
from trigpoint.edge.registration.planar_fit import PlanarFit
from trigpoint.edge.tracker import TargetTracker
from trigpoint.site.target import Face

FACES = [checkerboard(8, 5), charuco(), aprilgrid()]
STEP_NS = 100_000_000


def moving(face: Face, index: int) -> np.ndarray:
    """A face that moves by 15 pixels a picture and turns a little."""
    view = placed(face, distance=0.9, x=-0.2 + 0.025 * index, yaw_deg=3 * index, tilt_deg=15)
    return picture_of([view], noise=2.0, seed=index)


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.pattern.value)
def test_moving_face_is_found_in_every_picture(face: Face) -> None:
    tracker = TargetTracker([target_of(face)])
    for index in range(8):
        (found,) = tracker.detect(moving(face, index), index * STEP_NS)
        view = placed(face, distance=0.9, x=-0.2 + 0.025 * index, yaw_deg=3 * index, tilt_deg=15)
        error = found.pixels - true_pixels(view)[found.corners.astype(int)]
        assert len(found.corners) > 0.8 * face.corner_count
        assert np.sqrt(np.mean(error**2)) < 0.06


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.pattern.value)
def test_followed_face_costs_no_search(face: Face, monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = TargetTracker([target_of(face)])
    for index in range(2):
        tracker.detect(moving(face, index), index * STEP_NS)
    refuse_searches(monkeypatch)
    assert len(tracker.detect(moving(face, 2), 2 * STEP_NS)) == 1


def refuse_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the picture was searched")

    monkeypatch.setattr(tracker_module.TargetTracker, "_searched", refuse)


def test_face_that_stands_costs_no_search_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = TargetTracker([target_of(charuco())])
    for index in range(2):
        tracker.detect(moving(charuco(), 0), index * STEP_NS)
    refuse_searches(monkeypatch)
    assert len(tracker.detect(moving(charuco(), 0), 4 * STEP_NS)) == 1


def test_what_is_beside_is_not_searched_where_following_took_the_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nor is the picture given up: it can wait."""
    clock = ManualClock()
    tracker = TargetTracker([target_of(charuco())], budget_s=0.1, clock=clock)
    for index in range(2):
        tracker.detect(moving(charuco(), index), index * STEP_NS)
    followed = TargetTracker._followed

    def slowly(*given: Any) -> list[Any]:
        found = followed(*given)
        clock.advance(0.08)
        return found

    monkeypatch.setattr(TargetTracker, "_followed", slowly)
    refuse_searches(monkeypatch)
    assert len(tracker.detect(moving(charuco(), 3), 3 * STEP_NS)) == 1
    assert tracker.given_up == 0


@pytest.mark.parametrize(
    "faces",
    [
        (checkerboard(8, 5), checkerboard(8, 5, number=1)),
        (charuco(number=0), charuco(number=1, first=10)),
        (aprilgrid(), aprilgrid(number=1, first=30)),
    ],
    ids=lambda faces: faces[0].pattern.value,
)
def test_face_that_turns_into_view_is_found_before_the_whole_picture_is_searched(
    faces: tuple[Face, Face], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two faces of a robot that turns by 5 degrees a picture; the second shows its front from the
    fourth one on."""
    tracker = TargetTracker([target_of(*faces)])
    for index in range(4):
        turned = 5 * index
        view = [placed(faces[0], distance=1.1, x=-0.1 - 0.03 * index, yaw_deg=turned)]
        if index == 3:
            refuse_full_searches(monkeypatch)
            view.append(placed(faces[1], distance=1.1, x=0.06, yaw_deg=turned - 60))
        found = tracker.detect(picture_of(view, noise=1.0, seed=index), index * STEP_NS)
        assert len(found) == len(view)


def refuse_full_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    searched = TargetTracker._searched

    def only_beside(*given: Any) -> list[Any]:
        assert given[3] is not None, "the whole picture was searched"
        return searched(*given)

    monkeypatch.setattr(TargetTracker, "_searched", only_beside)


def test_face_that_jumps_is_found_again() -> None:
    face = checkerboard(8, 5)
    tracker = TargetTracker([target_of(face)])
    for index in range(3):
        tracker.detect(moving(face, index), index * STEP_NS)
    assert len(tracker.detect(moving(face, 16), 3 * STEP_NS)) == 1


def test_face_that_comes_in_is_found_within_the_time_of_a_search() -> None:
    faces = [charuco(number=0), charuco(number=1, first=10)]
    tracker = TargetTracker([target_of(*faces)])
    alone = [placed(faces[0], distance=1.0, x=-0.25)]
    both = [*alone, placed(faces[1], distance=1.0, x=0.25)]
    for index in range(3):
        assert len(tracker.detect(picture_of(alone), index * STEP_NS)) == 1
    seen = [len(tracker.detect(picture_of(both), index * STEP_NS)) for index in range(3, 9)]
    assert seen[-1] == 2


def test_face_that_leaves_is_not_made_up() -> None:
    tracker = TargetTracker([target_of(charuco())])
    for index in range(3):
        tracker.detect(moving(charuco(), index), index * STEP_NS)
    assert tracker.detect(plain_picture(noise=2.0), 3 * STEP_NS) == ()


@pytest.mark.parametrize(("x", "y"), [(0.06, 0.0), (0.03, 0.03), (-0.03, 0.03), (0.0, -0.06)])
def test_checkerboard_that_moves_by_whole_squares_keeps_its_numbers(x: float, y: float) -> None:
    """Moved so, its inner squares lie on each other; the outer ones do not."""
    face = checkerboard(8, 5)
    tracker = TargetTracker([target_of(face)])
    for index in range(4):
        view = placed(face, distance=0.9, x=x * (index == 3), y=y * (index == 3))
        (found,) = tracker.detect(picture_of([view]), index * STEP_NS)
        error = found.pixels - true_pixels(view)[found.corners.astype(int)]
        assert np.abs(error).max() < 0.3


def test_checkerboard_that_the_picture_cuts_off_is_not_taken_two_squares_beside() -> None:
    """Moved by two squares it shows as many corners: the picture hides where it ends."""
    face = checkerboard(12, 9)
    (finder,) = finders_for([target_of(face)]).values()
    picture = picture_of([placed(face, distance=0.9, x=0.49)])
    (there,) = finder.locate(picture, never)
    beside = there.found.fit.packed.copy()
    homography = beside[:9].reshape(3, 3)
    for squares in (0, 2):
        homography[:, 2] -= squares * face.square * homography[:, 0]
        found = finder.follow(picture, there, PlanarFit(beside), reach_px=1.0)
        assert (found is not None) == (squares == 0)


@pytest.mark.parametrize("face", FACES, ids=lambda face: face.pattern.value)
def test_face_that_comes_nearer_is_expected_where_it_is(face: Face) -> None:
    """Its corners' way in the picture grows from picture to picture, evenly in none."""
    tracker = TargetTracker([target_of(face)])
    views = [placed(face, distance=1.0 - 0.1 * i, x=-0.1 + 0.05 * i, tilt_deg=20) for i in range(3)]
    for index, view in enumerate(views[:2]):
        tracker.detect(picture_of([view], noise=1.0), index * STEP_NS)
    (track,) = tracker._tracks
    expected = track.fit_at(2 * STEP_NS).project(track.seen_points)
    off = expected - true_pixels(views[2])[track.located.found.corners]
    assert np.abs(off).max() < 0.8


def test_checkerboard_that_leaves_the_picture_is_not_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    face = checkerboard(8, 5)
    tracker = TargetTracker([target_of(face)])
    for index in range(3):
        view = placed(face, distance=0.9, x=0.07 + 0.18 * index)
        assert len(tracker.detect(picture_of([view]), index * STEP_NS)) == 1

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the board was measured")

    monkeypatch.setattr(detector_checkerboard, "measured", refuse)
    leaving = picture_of([placed(face, distance=0.9, x=0.61)])
    assert tracker._where_expected(leaving, tracker._tracks[0], 3 * STEP_NS, never) is None


def test_pictures_that_go_back_in_time_begin_anew() -> None:
    face = charuco()
    tracker = TargetTracker([target_of(face)])
    for stamp in (5, 6, 1, 1):
        assert len(tracker.detect(moving(face, 2), stamp * STEP_NS)) == 1


def test_search_that_takes_too_long_is_given_up_and_counted() -> None:
    class Slow(ManualClock):
        def elapsed_ns(self) -> int:
            self.advance(0.02)
            return super().elapsed_ns()

    tracker = TargetTracker([target_of(*FACES[:1])], budget_s=0.05, clock=Slow())
    for index in range(3):
        tracker.detect(picture_of([]), index * STEP_NS)
        tracker.detect(moving(FACES[0], 0), index * STEP_NS + 1)
    assert tracker.given_up > 0
