"""A differential drive's counters and the way they stand for."""

import math

import numpy as np
import pytest

from trigpoint.base.clock import to_ns
from trigpoint.geometry import Pose
from trigpoint.robot.line.arrival import ArrivalClock
from trigpoint.robot.line.wheels import WheelGeometry, WheelOdometry, wheel_geometry
from trigpoint.site.config import WheelConfig

GEOMETRY = WheelGeometry(left_m=0.001, right_m=0.001, track_m=0.25, bits=16)


def test_wheels_that_turn_alike_drive_straight() -> None:
    wheels = WheelOdometry()
    wheels.add(5, 5, GEOMETRY, 0)
    pose, linear, angular = wheels.add(505, 505, GEOMETRY, to_ns(0.5))
    np.testing.assert_allclose(pose.translation, [0.5, 0, 0])
    np.testing.assert_allclose((linear[0], angular[2]), (1.0, 0.0))


def test_quarter_of_a_circle_is_exact_in_one_step() -> None:
    """Radius 1 m about the left: the wheels go π/2 · (1 ∓ 0.125) m."""
    left, right = (round(1e6 * math.pi / 2 * (1 - side * 0.125)) for side in (1, -1))
    fine = WheelGeometry(1e-6, 1e-6, 0.25, 32)
    wheels = WheelOdometry()
    wheels.add(0, 0, fine, 0)
    pose, _, _ = wheels.add(left, right, fine, 1)
    np.testing.assert_allclose(pose.difference(Pose.planar(1, 1, math.pi / 2)), 0, atol=1e-5)


@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize("sign", [1, -1])
def test_counters_wrap_either_way(bits: int, sign: int) -> None:
    geometry = WheelGeometry(0.001, 0.001, 0.25, bits)
    wheels, pose = WheelOdometry(), Pose.identity()
    start = sign * ((1 << bits) - 150)
    for k in range(4):
        count = (start + sign * 100 * k) % (1 << bits)
        pose, _, _ = wheels.add(count, count, geometry, k)
    np.testing.assert_allclose(pose.translation, [sign * 0.3, 0, 0])


def test_signed_counters_of_a_board_wrap_too() -> None:
    geometry = WheelGeometry(0.001, 0.001, 0.25, 32)
    wheels = WheelOdometry()
    wheels.add(2**31 - 10, 2**31 - 10, geometry, 0)
    pose, _, _ = wheels.add(-(2**31) + 10, -(2**31) + 10, geometry, 1)
    np.testing.assert_allclose(pose.translation[0], 0.02)


def test_site_file_comes_before_the_robots_own_numbers() -> None:
    config = WheelConfig(track=0.3, left_scale=-1.0)
    found = wheel_geometry(config, 16, diameter_m=1 / math.pi, track_m=0.2, ticks=100)
    assert found == WheelGeometry(-0.01, 0.01, 0.3, 16)
    assert wheel_geometry(config, 16) is None


def test_steady_readings_are_stamped_evenly_though_they_arrive_late_and_together() -> None:
    random = np.random.default_rng(1)
    period_ns, line_ns = to_ns(0.015), to_ns(0.0008)
    clock, errors = ArrivalClock(period_ns, line_ns), []
    for k in range(2000):
        taken_ns = round(k * period_ns * (1 + 50e-6))
        late_ns = round(random.exponential(to_ns(0.001)))
        errors.append(clock.taken_ns(taken_ns + line_ns + late_ns) - taken_ns)
    settled = np.abs(errors[200:])
    assert np.percentile(settled, 95) < to_ns(0.0006)  # the arrival alone: 3 ms
    assert settled.max() < to_ns(0.002)


def test_stamps_stay_in_order_and_begin_anew_after_a_silence() -> None:
    clock = ArrivalClock(to_ns(0.015), 0)
    arrivals = [0, 15, 15, 60, 61, 75, 2000, 2015]
    found = [clock.taken_ns(to_ns(at / 1e3)) for at in arrivals]
    assert found == sorted(set(found))
    assert found[-2] == to_ns(2.0)
