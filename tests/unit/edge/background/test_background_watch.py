"""A camera notices that it was turned or shifted, and nothing else that happens before it."""

from collections.abc import Callable
from copy import deepcopy
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from support.pictures.rooms import room

from benchmarks.pictures.still_hours import StillHour
from benchmarks.pictures.still_scene import Blob, Light, Stand, StillScene
from trigpoint.edge.background.watch import BackgroundWatch, View
from trigpoint.geometry.rotation import Array

BEFORE_S = 40
SECOND = 10**9


def scene(seed: int = 1, sigma: float = 3.0) -> StillScene:
    return StillScene(room(seed), np.random.default_rng(seed), sigma=sigma)


@cache
def _settled(seed: int) -> tuple[StillScene, BackgroundWatch]:
    drawn, watch = scene(seed), BackgroundWatch()
    for second in range(BEFORE_S):
        assert not watch.look(drawn.picture(), second * SECOND)
    assert watch.view is View.STILL
    return drawn, watch


def watched(seed: int = 1) -> tuple[StillScene, BackgroundWatch]:
    """A background, and a watch that has seen it for a while."""
    return deepcopy(_settled(seed))


def delay_s(
    watch: BackgroundWatch, picture: Callable[[float], np.ndarray], within_s: float = 10.0
) -> float:
    """After how long a nudge is said that was half a second after the last comparison."""
    for number in range(round(within_s * 10)):
        after_s = number / 10
        if watch.look(picture(after_s), round((BEFORE_S - 0.5 + after_s) * SECOND)):
            return after_s
    return np.inf


@pytest.mark.parametrize(
    "stand",
    [
        Stand(pan=0.3),
        Stand(tilt=-0.3),
        Stand(pan=1.0, tilt=0.5),
        Stand(pan=5.0),
        Stand(roll=1.0),
        Stand(shift_m=0.02),
    ],
    ids=str,
)
def test_nudge_is_said_within_three_seconds_and_once(stand: Stand) -> None:
    drawn, watch = watched()
    assert delay_s(watch, lambda _: drawn.picture(stand)) <= 3.0
    nudge = watch.nudge
    assert nudge is not None
    assert (BEFORE_S - 1) * SECOND <= nudge.until_ns < nudge.since_ns
    assert nudge.since_ns <= (BEFORE_S + 1.5) * SECOND
    for second in range(BEFORE_S + 10, 3 * BEFORE_S):
        assert not watch.look(drawn.picture(stand), second * SECOND)
    assert watch.count == 1
    assert watch.view is View.STILL


def test_shift_of_the_picture_is_measured() -> None:
    """Off its middle a picture shifts more, by up to a third at 60 degrees; that is averaged."""
    drawn, watch = watched(3)
    delay_s(watch, lambda _: drawn.picture(Stand(pan=0.6)))
    assert watch.nudge is not None
    focal_widths = 0.5 / np.tan(np.radians(30))
    across, down = watch.nudge.shift
    assert 0.58 < np.degrees(np.arctan(-across / focal_widths)) < 0.68
    assert abs(down) < 0.001


def test_nudge_in_another_light_is_said() -> None:
    drawn, watch = watched(2)
    lamps = np.array([[0.3, 0.3, 0.3, 0.4], [0.8, 0.6, 0.25, -0.3]])
    light = Light(0.7, 1.2, 8.0, lamps)
    assert delay_s(watch, lambda _: drawn.picture(Stand(pan=0.3), light)) <= 3.0


def test_second_nudge_is_another_one() -> None:
    drawn, watch = watched(2)
    delay_s(watch, lambda _: drawn.picture(Stand(pan=1.0)))
    first = watch.nudge
    for second in range(BEFORE_S + 10, 3 * BEFORE_S):
        watch.look(drawn.picture(Stand(pan=1.0)), second * SECOND)
    for second in range(3 * BEFORE_S, 3 * BEFORE_S + 5):
        watch.look(drawn.picture(Stand(pan=2.0)), second * SECOND)
    assert watch.count == 2
    assert first is not None
    assert watch.nudge is not None
    assert watch.nudge.until_ns > first.since_ns


def test_camera_that_is_still_being_moved_prolongs_the_nudge() -> None:
    drawn, watch = watched(2)
    delay_s(watch, lambda _: drawn.picture(Stand(pan=1.0)))
    first = watch.nudge
    for second in range(BEFORE_S + 10, BEFORE_S + 15):
        watch.look(drawn.picture(Stand(pan=3.0)), second * SECOND)
    assert first is not None
    assert watch.nudge is not None
    assert watch.nudge.until_ns == first.until_ns
    assert watch.nudge.since_ns > first.since_ns


LAMPS = np.array([[0.2, 0.4, 0.2, 0.6], [0.7, 0.2, 0.3, -0.5]])
LOOKS = room(9)


@pytest.mark.parametrize(
    "draw",
    [
        lambda drawn, _: drawn.picture(light=Light(0.5, 1.3, 20.0)),
        lambda drawn, _: drawn.picture(light=Light(lamps=LAMPS)),
        lambda drawn, _: drawn.picture(light=Light(0.004)),
        lambda drawn, _: drawn.picture(zoom=0.02),
        lambda drawn, second: drawn.picture(zoom=0.025 * np.sin(second)),
        lambda drawn, second: drawn.picture(
            blobs=(Blob(0.05 * second % 1.2, 0.4, 0.15, 0.35, LOOKS),)
        ),
        lambda drawn, _: drawn.picture(blobs=(Blob(0.3, 0.4, 0.3, 0.4, LOOKS, is_square=True),)),
        lambda drawn, second: drawn.picture(
            blobs=(Blob(0.5 + 0.01 * (second % 2), 0.4, 0.7, 0.7, LOOKS, is_square=True),)
        ),
        lambda drawn, _: drawn.picture(
            drops=np.random.default_rng(1).uniform([0, 0, 0.01], [1, 0.75, 0.05], (40, 3))
        ),
        lambda *_: np.full((240, 320), 7, np.uint8),
        lambda drawn, second: drawn.picture(Stand(pan=0.05 * np.sin(second))),
    ],
    ids=[
        "gain, gamma and offset", "lamps", "night", "focused elsewhere", "focusing",
        "somebody passes", "half of it is covered", "all of it is covered", "rain on the glass",
        "a grey picture", "a mount that sways",
    ],
)  # fmt: skip
def test_nothing_is_said_of_what_is_no_nudge(
    draw: Callable[[StillScene, int], np.ndarray],
) -> None:
    drawn, watch = watched(4)
    for second in range(BEFORE_S, 3 * BEFORE_S):
        assert not watch.look(draw(drawn, second), second * SECOND)
    for second in range(3 * BEFORE_S, 3 * BEFORE_S + 5):
        assert not watch.look(drawn.picture(), second * SECOND)
    assert watch.count == 0
    assert watch.view is View.STILL


def test_nudge_in_the_dark_is_said_in_the_morning() -> None:
    drawn, watch = watched(5)
    for second in range(BEFORE_S, 2 * BEFORE_S):
        stand = Stand() if second < 1.5 * BEFORE_S else Stand(pan=0.5)
        assert not watch.look(drawn.picture(stand, Light(0.004)), second * SECOND)
        assert watch.view is View.HIDDEN
    noticed = [
        watch.look(drawn.picture(Stand(pan=0.5)), second * SECOND)
        for second in range(2 * BEFORE_S, 2 * BEFORE_S + 4)
    ]
    assert any(noticed)
    assert watch.nudge is not None
    assert watch.nudge.until_ns == (BEFORE_S - 1) * SECOND


def test_target_is_no_background() -> None:
    """A board that fills most of the picture, moved a little: with its outline it says nothing."""
    drawn = scene(6)
    board = Blob(0.5, 0.4, 0.3, 0.3, LOOKS, is_square=True)

    def outline(blob: Blob) -> Array:
        across, down = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]).T
        corners = np.stack([blob.x + across * blob.across, blob.y + down * blob.down], axis=1)
        return corners * 320

    watch = BackgroundWatch()
    for second in range(3 * BEFORE_S):
        seen = board if second < BEFORE_S else replace(board, x=0.51)
        watch.look(drawn.picture(blobs=(seen,)), second * SECOND, [outline(seen)])
    assert watch.count == 0


def test_reference_is_small_and_most_pictures_are_passed_over() -> None:
    drawn, watch = watched()
    assert watch.size_bytes < 300_000
    last = watch.last
    assert not watch.look(drawn.picture(), round((BEFORE_S - 0.3) * SECOND))
    assert watch.last is last


@pytest.mark.parametrize("shape", [(1080, 1920, 3), (480, 640), (30, 40), (9, 4000), (2, 2)])
def test_pictures_of_any_size_are_taken(shape: tuple[int, ...]) -> None:
    random, watch = np.random.default_rng(1), BackgroundWatch()
    picture = random.integers(0, 255, shape).astype(np.uint8)
    for second in range(3):
        assert not watch.look(picture, second * SECOND)


def test_clock_that_was_set_back_is_followed() -> None:
    drawn, watch = watched()
    last = watch.last
    watch.look(drawn.picture(), 5 * SECOND)
    assert watch.last is not last


def test_drawn_minutes_in_which_nothing_is_touched() -> None:
    random = np.random.default_rng(0)
    hour = StillHour(StillScene(room(20), random), [room(7), room(8)], random)
    watch = BackgroundWatch()
    for second, picture in enumerate(hour.pictures(200)):
        watch.look(picture, second * SECOND)
    assert watch.count == 0
