"""The checkpoint's odometry of a robot that stands: little of it, and it says the same."""

import numpy as np
import pytest

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.model.odometry import MOST_STANDING, Added, OdometryTrack
from trigpoint.fusion.standing_odometry import StandingOdometry
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

HOUR_S = 3600


def message(stamp_ns: int, x: float = 0.0) -> Odometry:
    return Odometry(stamp_ns, "r1/odom", "r1/base", Pose.planar(x, 0.0, 0.0))


def stored(
    messages: list[Odometry], *, kept: StandingOdometry | None = None
) -> tuple[list[Odometry], StandingOdometry]:
    """What of these messages is stored, the ones that are held back left out."""
    kept = kept or StandingOdometry()
    found = [
        p for m in messages for p in kept.take(m, b"%d %.6f" % (m.stamp_ns, m.pose.translation[0]))
    ]
    return [message(int(stamp), float(x)) for stamp, x in map(bytes.split, found)], kept


def stamps_of(messages: list[Odometry]) -> list[int]:
    return [m.stamp_ns for m in messages]


def standing(seconds: float, period_s: float) -> list[Odometry]:
    return [message(to_ns(i * period_s)) for i in range(1, round(seconds / period_s))]


@pytest.mark.parametrize("period_s", [0.1, 0.5, 0.9])
def test_what_is_read_again_of_an_hour_is_little_and_has_no_gap(period_s: float) -> None:
    messages = standing(HOUR_S, period_s)
    driven = messages[-1].stamp_ns
    on = [message(driven + to_ns(period_s * i), 0.01 * i) for i in range(1, 10)]
    found, _ = stored([*messages, *on])
    assert len(found) < MOST_STANDING + 40
    assert stamps_of(found[-len(on) - 2 :]) == stamps_of([*messages[-2:], *on])
    track = OdometryTrack(OdometryNoise(), planar=True)
    assert {track.add(m.stamp_ns, m.pose) for m in found} == {Added.TAKEN}
    moments = np.linspace(found[0].stamp_ns, found[-1].stamp_ns, 500).astype(int)
    assert not any(track.is_in_gap(stamp_ns) for stamp_ns in moments.tolist())


def test_a_gap_after_a_standstill_is_one_where_it_is_read_again() -> None:
    messages = standing(600.0, 0.1)
    after = message(messages[-1].stamp_ns + to_ns(300.0), 0.5)
    found, _ = stored([*messages, after])
    track = OdometryTrack(OdometryNoise(), planar=True)
    for m in found:
        track.add(m.stamp_ns, m.pose)
    assert track.is_in_gap(after.stamp_ns - to_ns(100.0))
    assert not track.is_in_gap(messages[-1].stamp_ns)


def test_gaps_in_a_standstill_cost_little_and_are_gaps_where_it_is_read_again() -> None:
    messages = standing(600.0, 0.1)
    part_ns = to_ns(615.0)  # 15 s of it are missing
    parts = [[message(m.stamp_ns + n * part_ns) for m in messages] for n in range(4)]
    found, _ = stored([m for part in parts for m in part])
    assert len(found) < MOST_STANDING + 4 * 20
    track = OdometryTrack(OdometryNoise(), planar=True)
    for m in found:
        track.add(m.stamp_ns, m.pose)
    assert len(track) < MOST_STANDING + 4 * 3
    for number in range(1, 4):
        assert track.is_in_gap(number * part_ns - to_ns(7.0))
        assert not track.is_in_gap(number * part_ns + to_ns(300.0))


def test_odometry_of_a_stored_sightings_moment_is_stored() -> None:
    messages = standing(600.0, 0.1)
    found, kept = stored(messages)
    assert found[-1].stamp_ns < messages[-1].stamp_ns - to_ns(60.0)
    kept.want(messages[-1].stamp_ns)
    last = messages[-1].stamp_ns
    found, _ = stored([message(last + to_ns(0.1 * i)) for i in range(1, 4)], kept=kept)
    assert [m.stamp_ns >= last for m in found] == [True]


def test_everything_of_a_driving_robot_is_stored() -> None:
    messages = [message(to_ns(0.1 * i), 1e-4 * i) for i in range(1, 3 * MOST_STANDING)]
    assert stamps_of(stored(messages)[0]) == stamps_of(messages)


def test_the_rest_is_what_an_orderly_stop_stores() -> None:
    _, kept = stored(standing(600.0, 0.1))
    assert len(kept.rest()) == 2
    assert kept.rest() == []


def test_of_odometry_that_trembles_little_is_kept_and_leads_to_the_same_place() -> None:
    draw, hz = np.random.default_rng(2), 20
    x = np.concatenate([np.zeros(600 * hz), 0.3 * np.arange(1, 3 * hz) / hz])
    x = np.round(x + 1e-3 * draw.normal(size=len(x)), 6)
    messages = [message(to_ns(i / hz), float(one)) for i, one in enumerate(x, 1)]
    found, _ = stored(messages)
    assert len(found) < MOST_STANDING + 5 * hz + 3 * hz + 40
    tracks = [OdometryTrack(OdometryNoise(), planar=True) for _ in range(2)]
    for track, some in zip(tracks, (messages, found), strict=True):
        assert {track.add(m.stamp_ns, m.pose) for m in some} == {Added.TAKEN}
    assert len(tracks[0]) < MOST_STANDING + 5 * hz + 3 * hz
    ends = [track.odom_from_base[-1].translation for track in tracks]
    assert np.linalg.norm(ends[0] - ends[1]) < 1e-9
