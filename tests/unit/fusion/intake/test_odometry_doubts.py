"""Odometry as people send it: what is odd is said, and of sound odometry nothing."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from support.builders import make_site

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.intake.odometry_doubts import OdometryDoubts
from trigpoint.fusion.model.odometry import Added, OdometryTrack
from trigpoint.fusion.model.readings import Readings
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import exp, to_quaternion

BEGIN_NS = to_ns(1.7e9)
Change = Callable[[Odometry], Odometry]


def heading(message: Odometry) -> float:
    return float(np.arctan2(message.pose.rotation[1, 0], message.pose.rotation[0, 0]))


def turned(message: Odometry, heading_rad: float) -> Odometry:
    pose = Pose(exp([0.0, 0.0, heading_rad]), message.pose.translation)
    return replace(message, pose=pose)


def moved(message: Odometry, translation: list[float]) -> Odometry:
    return replace(message, pose=Pose(message.pose.rotation, np.array(translation)))


def with_w_first(message: Odometry) -> Odometry:
    x, y, z, w = to_quaternion(message.pose.rotation)
    pose = Pose.from_quaternion(message.pose.translation, [w, x, y, z])
    return replace(message, pose=pose)


def exchanged(message: Odometry) -> Odometry:
    x, y, z = message.pose.translation
    return moved(message, [y, x, z])


def longer(message: Odometry, by: float) -> Odometry:
    return moved(message, list(by * message.pose.translation))


def later(message: Odometry, by: float) -> Odometry:
    """As if so many seconds were one."""
    since_ns = message.stamp_ns - BEGIN_NS
    return replace(message, stamp_ns=BEGIN_NS + round(since_ns * by))


WRONG: dict[str, tuple[Change, str]] = {
    "w first": (with_w_first, "x, y, z, w"),
    "x and y exchanged": (exchanged, "sideways"),
    "degrees for radians": (lambda m: turned(m, np.degrees(heading(m))), "radians"),
    "no heading": (lambda m: turned(m, 0.0), "sideways"),
    "millimetres": (lambda m: longer(m, 1000), "lengths in metres"),
    "inches": (lambda m: longer(m, 39.37), "lengths in metres"),
    "milliseconds": (lambda m: later(m, 1000), "milli- or nanoseconds"),
    "microseconds": (lambda m: later(m, 1e6), "milli- or nanoseconds"),
    "whole seconds": (
        lambda m: replace(m, stamp_ns=m.stamp_ns // 10**9 * 10**9),
        "lack the nanoseconds",
    ),
}


def said(
    change: Change,
    *,
    speed: float,
    rate: float,
    turn: float,
    noise: float = 0.0,
    shake_m: float = 0.0,
) -> str:
    """Of a drive of half a minute along an eight, changed. `shake_m`: noise of each place alone."""
    site, random = make_site(), np.random.default_rng(0)
    tracks = {"r1": OdometryTrack(site.robots["r1"].odometry, planar=True)}
    doubts = OdometryDoubts(site, tracks)
    pose, count = Pose.identity(), int(30 * rate)
    for number in range(count):
        shaken = pose.translation + shake_m * random.normal(size=3) * [1, 1, 0]
        here = Pose(pose.rotation, shaken)
        message = change(Odometry(BEGIN_NS + to_ns(number / rate), "r1/odom", "r1/base", here))
        is_stale = tracks["r1"].add(message.stamp_ns, message.pose) is Added.STALE
        doubts.add("r1", Readings.of([message]), stale=is_stale)
        angle = (turn if number < count / 2 else -turn) / rate + noise * random.normal()
        step = np.array([speed / rate + noise * random.normal(), noise * random.normal(), 0.0])
        pose = pose @ Pose(exp([0.0, 0.0, angle]), step)
    return "\n".join(doubts.texts)


DRIVES = {"speed": st.floats(0.3, 1.5), "rate": st.sampled_from([5.0, 10.0, 30.0])}


@pytest.mark.parametrize("kind", WRONG)
@settings(max_examples=10, deadline=None)
@given(st.floats(0.4, 1.2), st.data())
def test_what_is_odd_is_said(kind: str, turn: float, data: st.DataObject) -> None:
    change, words = WRONG[kind]
    drive = {key: data.draw(values, key) for key, values in DRIVES.items()}
    assert words in said(change, turn=turn, **drive)


@settings(max_examples=40, deadline=None)
@given(
    st.just(0.0) | st.floats(0, 1.5),
    st.floats(-1.2, 1.2),
    st.floats(0, 2e-3),
    st.floats(0, 2e-3),
    st.data(),
)
def test_of_sound_odometry_nothing_is_said(
    speed: float, turn: float, noise: float, shake_m: float, data: st.DataObject
) -> None:
    """Also of a robot that stands or turns on the spot."""
    rate = data.draw(DRIVES["rate"], "rate")
    drive = {"speed": speed, "rate": rate, "turn": turn, "noise": noise, "shake_m": shake_m}
    assert said(lambda message: message, **drive) == ""


def first_unset(message: Odometry) -> Odometry:
    """The clock was set after the first message."""
    return replace(message, stamp_ns=0) if message.stamp_ns == BEGIN_NS else message


def resting(message: Odometry) -> Odometry:
    """Nothing comes for two minutes now and then, in which it stands."""
    passed_s = (message.stamp_ns - BEGIN_NS) // 10**9
    return replace(message, stamp_ns=message.stamp_ns + to_ns(120.0) * (passed_s // 5))


@pytest.mark.parametrize("change", [first_unset, resting])
def test_stamps_that_are_seldom_far_apart_are_sound(change: Change) -> None:
    assert said(change, speed=0.0, rate=5.0, turn=0.0) == ""
    assert "milli" not in said(change, speed=0.4, rate=5.0, turn=0.3)
