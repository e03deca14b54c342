"""Odometry of robots that stand: encoders, gyroscopes that creep, fused poses that tremble."""

import copy
import math
import pickle
from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from trigpoint.fusion.model.odometry import MOST_STANDING, OdometryTrack
from trigpoint.fusion.model.rest import Rest
from trigpoint.geometry import Pose
from trigpoint.site.config import OdometryNoise

S = 10**9
REST_S = 90.0


def planar(x: float, y: float, heading: float) -> Pose:
    c, s = math.cos(heading), math.sin(heading)
    return Pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([x, y, 0.0]))


def heading(pose: Pose) -> float:
    return math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])


@dataclass(frozen=True)
class Noise:
    """`place`: of each reading, m; `walk`: of the heading, rad/√s; `bias`: of a gyroscope, rad/s;
    `jitter`: of each heading, rad."""

    place: float = 0.0
    walk: float = 0.0
    bias: float = 0.0
    jitter: float = 0.0


KINDS = st.one_of(
    st.just(Noise()),
    st.builds(  # wheels and a gyroscope
        Noise, walk=st.floats(1e-5, 1e-3), bias=st.floats(-1e-3, 1e-3)
    ),
    st.builds(  # fused
        Noise, place=st.floats(1e-4, 1.5e-3), jitter=st.floats(1e-5, 1e-3)
    ),
)


Way = list[tuple[float, float, float]]


def reported(true: Way, hz: int, noise: Noise, seed: int) -> list[Pose]:
    """What odometry says of a way."""
    walk, dx, dy, jitter = np.random.default_rng(seed).normal(size=(len(true), 4)).T
    creep = np.cumsum(noise.bias / hz + noise.walk / math.sqrt(hz) * walk)
    x, y, turn = np.array(true).T
    headings = turn + creep + noise.jitter * jitter
    poses = Pose.planar(x + noise.place * dx, y + noise.place * dy, headings)
    return [poses[k] for k in range(len(true))]


def drive(hz: int) -> Way:
    """Two seconds at 0.3 m/s, from the origin."""
    return [(0.3 * k / hz, 0.0, 0.0) for k in range(1, 2 * hz + 1)]


@settings(deadline=None, max_examples=60)
@given(noise=KINDS, hz=st.sampled_from([10, 30, 50, 100]), seed=st.integers(0, 10**6))
def test_what_a_standing_robot_reports_is_no_motion_and_its_drives_are_kept(
    noise: Noise, hz: int, seed: int
) -> None:
    out = drive(hz)
    x = out[-1][0]
    stand = [(x, 0.0, 0.0)] * int(REST_S * hz)
    on = [(x + dx, 0.0, 0.0) for dx, _, _ in drive(hz)]
    rest = Rest()
    poses = reported(out + stand + on, hz, noise, seed)
    found = [rest.add(S * k // hz, pose) for k, pose in enumerate(poses)]
    settled = found[len(out) + 4 * hz : len(out) + len(stand)]
    rows = Pose.stack(settled).rows()
    assert np.mean(np.any(rows[1:] != rows[:-1], axis=1)) < 0.05
    # The heading has crept only while the robot drove, came to rest or left.
    crept = abs(heading(found[-1]))
    assert crept < 12 * abs(noise.bias) + 12 * noise.walk + 8 * noise.jitter + 1e-9
    assert abs(np.linalg.norm(found[-1].translation) - (x + 0.6)) < 0.02


@settings(deadline=None, max_examples=60)
@given(
    noise=KINDS,
    hz=st.sampled_from([10, 30, 50, 100]),
    speed=st.sampled_from([(0.01, 0.0), (0.0, math.radians(1)), (0.02, math.radians(3))]),
    seed=st.integers(0, 10**6),
)
def test_slow_motion_is_not_taken_for_standing(
    noise: Noise, hz: int, speed: tuple[float, float], seed: int
) -> None:
    metres, turn = speed
    still = [(0.0, 0.0, 0.0)] * (5 * hz)
    creep = [(metres * k / hz, 0.0, turn * k / hz) for k in range(20 * hz)]
    poses = reported(still + creep, hz, noise, seed)
    rest = Rest()
    found = [rest.add(S * k // hz, pose) for k, pose in enumerate(poses)]
    for here, told in zip(found[5 * hz :: hz], poses[5 * hz :: hz], strict=True):
        assert np.linalg.norm(here.translation - told.translation) < 0.015 + 0.004
        assert abs(heading(here) - heading(told)) < math.radians(1.6) + 5 * abs(noise.bias)


def test_odometry_without_noise_is_as_it_was_said() -> None:
    rest, draw = Rest(), np.random.default_rng(3)
    x, turn = 0.0, 0.0
    for k in range(2000):
        if k // 400 % 2:
            x, turn = x + 0.004, turn + 1e-3 * draw.normal()
        pose = planar(x, 0.1, turn)
        found = rest.add(k * S // 50, pose)
        assert np.array_equal(found.translation, pose.translation)
        assert np.array_equal(found.rotation, pose.rotation)


def test_what_happens_in_a_silence_is_motion() -> None:
    """A robot that stood is turned by hand while its odometry is silent."""
    noise = Noise(walk=1e-4, jitter=1e-4)
    rest = Rest()
    poses = reported([(0.0, 0.0, 0.0)] * 500, 50, noise, 1)
    before = [rest.add(k * S // 50, pose) for k, pose in enumerate(poses)][-1]
    after = rest.add(20 * S, planar(0.0, 0.0, heading(poses[-1]) + 0.5))
    assert abs(heading(before.inverse() @ after) - 0.5) < 0.02


def parked(noise: Noise, seconds: int) -> OdometryTrack:

    track = OdometryTrack(OdometryNoise(), planar=True)
    for k, pose in enumerate(reported([(1.0, 2.0, 0.3)] * (20 * seconds), 20, noise, 4)):
        track.add(k * S // 20, pose)
    return track


def test_a_parked_robot_fills_no_memory() -> None:
    noise = Noise(place=1e-3, walk=1e-4, bias=3e-4, jitter=1e-4)
    assert len(parked(noise, 600)) < MOST_STANDING + 300


def test_the_map_is_told_by_what_the_robot_reports_now() -> None:
    noise = Noise(bias=1e-3, walk=1e-5)
    track = parked(noise, 300)
    assert abs(heading(track.odom_from_base[-1]) - 0.3) < 0.02
    assert abs(heading(track.reported) - 0.6) < 0.02


def test_a_copy_goes_on_by_itself() -> None:
    """Tracks are sent to the process that solves, and copied with all else of an estimator."""
    poses = reported([(0.0, 0.0, 0.0)] * 300 + drive(50), 50, Noise(place=1e-3, jitter=1e-4), 2)
    rest = Rest(planar=True)
    for k, pose in enumerate(poses[:200]):
        rest.add(k * S // 50, pose)
    copies = [copy.deepcopy(rest), pickle.loads(pickle.dumps(rest))]
    assert rest.trembles
    for each in (*copies, rest):  # one after the other, so that none could move another
        assert each.trembles
    told = [
        [each.add(k * S // 50, pose).rows() for k, pose in enumerate(poses[200:], start=200)]
        for each in (*copies, rest)
    ]
    assert np.array_equal(told[0], told[1])
    assert np.array_equal(told[0], told[2])
