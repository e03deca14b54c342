"""Odometry of a robot that stands for long: what is kept of it says the same as all of it."""

import numpy as np
import pytest

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model import odometry
from trigpoint.fusion.model.odometry import MOST_STANDING, Added, OdometryTrack
from trigpoint.fusion.model.readings import Readings
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

PERIOD_NS = to_ns(0.02)
STANDS = 3 * MOST_STANDING
# Message numbers: it drives to the first, stands to the second, drives on to the third.
STOPS, STARTS, ENDS = 100, 100 + STANDS, 200 + STANDS
NO_SCALES = np.zeros(2)


def track_of() -> OdometryTrack:
    track = OdometryTrack(OdometryNoise(), planar=True)
    for number in range(ENDS):
        driven = min(number, STOPS) + max(number - STARTS, 0)
        pose = Pose.planar(0.01 * driven, 0.002 * driven, 0.01 * driven)
        assert track.add(number * PERIOD_NS, pose) is Added.TAKEN
    return track


@pytest.fixture(name="everything")
def _everything(monkeypatch: pytest.MonkeyPatch) -> OdometryTrack:
    """The same with every message."""
    with monkeypatch.context() as patch:
        patch.setattr(odometry, "MOST_STANDING", STANDS + 1)
        return track_of()


def moments(*numbers: float) -> np.ndarray:
    return np.array([round(number * PERIOD_NS) for number in numbers], dtype=np.int64)


def assert_same_motion(track: OdometryTrack, other: OdometryTrack, *numbers: float) -> None:
    motion, expected = (t.motion(moments(*numbers), NO_SCALES) for t in (track, other))
    difference = motion.earlier_from_later.difference(expected.earlier_from_later)
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)
    np.testing.assert_allclose(motion.covariance, expected.covariance, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(motion.is_still, expected.is_still)


def test_a_long_standstill_is_kept_as_one_step(everything: OdometryTrack) -> None:
    track = track_of()
    assert len(everything) == ENDS
    assert len(track) == ENDS - STANDS + MOST_STANDING
    assert track.last_ns == everything.last_ns


def test_what_is_kept_of_a_standstill_says_the_same(everything: OdometryTrack) -> None:
    track, middle = track_of(), (STOPS + STARTS) / 2
    numbers = (3.5, STOPS - 0.5, STOPS + 7, middle, middle + 0.3, STARTS, STARTS + 1.5, ENDS - 1)
    assert_same_motion(track, everything, *numbers)
    for number in numbers:
        (stamp_ns,) = moments(number).tolist()
        assert not track.is_in_gap(stamp_ns)
        for after_s in (-0.03, 0.05):
            moved, twist = track.carried(moments(number), np.array([after_s]), NO_SCALES)
            expected, wanted = everything.carried(moments(number), np.array([after_s]), NO_SCALES)
            np.testing.assert_allclose(moved.difference(expected), 0.0, atol=1e-12)
            np.testing.assert_allclose(twist, wanted, atol=1e-12)


def test_a_gap_after_a_long_standstill_is_one() -> None:
    track = OdometryTrack(OdometryNoise(), planar=True)
    for number in range(STANDS):
        track.add(number * PERIOD_NS, Pose.identity())
    track.add((STANDS + 500) * PERIOD_NS, Pose.identity())
    assert track.is_in_gap((STANDS + 250) * PERIOD_NS)
    assert not track.is_in_gap((STANDS - 250) * PERIOD_NS)


def test_a_lift_in_a_long_standstill_breaks_the_way_where_it_was() -> None:
    track, middle = track_of(), (STOPS + STARTS) // 2
    track.break_between(middle * PERIOD_NS, (middle + 10) * PERIOD_NS)
    motion = track.motion(moments(STOPS, middle, middle + 10, STARTS, ENDS - 1), NO_SCALES)
    is_wide = motion.covariance[:, 0, 0] > 1.0
    assert is_wide.tolist() == [False, True, False, False]
    pieces = track.pieces(moments(STOPS, middle, middle + 10, ENDS - 1))
    assert pieces.tolist() == [0, 0, 1, 1]


def test_a_lift_that_is_taken_back_leaves_the_standstill_as_it_was(
    everything: OdometryTrack,
) -> None:
    track, middle = track_of(), (STOPS + STARTS) // 2
    before = len(track)
    for _ in range(5):
        track.break_between(middle * PERIOD_NS, (middle + 10) * PERIOD_NS)
        track.mend()
    assert len(track) == before + 2
    assert_same_motion(track, everything, STOPS, middle, middle + 5, middle + 10, ENDS - 1)


def test_breaks_are_the_same_on_another_track_of_the_same_robot() -> None:
    track, other, middle = track_of(), track_of(), (STOPS + STARTS) // 2
    track.break_between(middle * PERIOD_NS, (middle + 10) * PERIOD_NS)
    track.break_between(20 * PERIOD_NS, 30 * PERIOD_NS)
    other.jump_in(track.jump_steps)
    assert other.jump_steps == track.jump_steps
    numbers = moments(10, 40, middle, middle + 10, ENDS - 1)
    assert other.pieces(numbers).tolist() == track.pieces(numbers).tolist() == [0, 1, 1, 2, 2]


def test_a_robot_that_stands_still_after_a_lift_is_tied_to_where_it_stands_now() -> None:
    track = OdometryTrack(OdometryNoise(), planar=True)
    for number in range(STANDS):
        track.add(number * PERIOD_NS, Pose.identity())
    last = STANDS - 1
    track.break_between((last - 10) * PERIOD_NS, last * PERIOD_NS)
    for number in range(STANDS, 2 * STANDS):
        track.add(number * PERIOD_NS, Pose.identity())
    motion = track.motion(moments(last - 10, last, 2 * STANDS - 1), NO_SCALES)
    assert motion.is_still.tolist() == [False, True]
    assert len(track) < MOST_STANDING + 10


def test_messages_at_once_are_taken_as_one_after_the_other() -> None:
    """With a standstill that is merged, jumps, gaps and messages that are not newer."""
    random = np.random.default_rng(3)
    steps = random.choice([0.0, 0.02, 30.0], size=4000, p=[0.2, 0.79, 0.01])
    steps[1000 : 1100 + 2 * MOST_STANDING] = 0.0
    apart_ns = random.choice([0, PERIOD_NS, 2 * 10**9], size=len(steps), p=[0.05, 0.94, 0.01])
    stamps_ns, poses = np.cumsum(apart_ns), Pose.planar(np.cumsum(steps), 0.0, 0.0)
    single, several = (OdometryTrack(OdometryNoise(), planar=True) for _ in range(2))
    added = [single.add(int(ns), poses[row]) for row, ns in enumerate(stamps_ns)]
    readings = Readings(stamps_ns, poses)
    some = [several.add_run(readings[row : row + 37]) for row in range(0, len(steps), 37)]
    assert [each for outcome in some for each in outcome] == added
    assert set(added) == set(Added)
    assert len(several) == len(single) < len(steps) - MOST_STANDING
    assert several.jump_steps == single.jump_steps
    assert several.reported.rows().tobytes() == single.reported.rows().tobytes()
    for mine, other in zip(several._tables, single._tables, strict=True):
        assert mine.tobytes() == other.tobytes()
