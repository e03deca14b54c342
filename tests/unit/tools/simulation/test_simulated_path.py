"""Paths and drives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.tools.simulation.motion.path import Drive, rounded_path

CORNER = rounded_path([[0, 0], [2, 0], [2, 2]], 0.5)


def test_a_corner_becomes_an_arc_of_the_radius() -> None:
    assert CORNER.length == pytest.approx(1.5 + 0.5 * np.pi / 2 + 1.5)
    middle = CORNER.at(1.5 + 0.5 * np.pi / 4)
    centre = np.array([1.5, 0.5, 0.0])
    assert np.linalg.norm(middle.translation - centre) == pytest.approx(0.5)
    assert middle.heading == pytest.approx(np.pi / 4)


def test_a_path_is_held_at_both_ends() -> None:
    assert np.allclose(CORNER.at(-1.0).translation, [0, 0, 0])
    assert np.allclose(CORNER.at(99.0).translation, [2, 2, 0])


@given(
    st.lists(st.tuples(st.integers(-4, 4), st.integers(-4, 4)), min_size=3, max_size=6),
    st.floats(0.1, 2.0),
)
def test_a_robot_never_jumps_and_looks_where_it_goes(
    waypoints: list[tuple[int, int]], radius: float
) -> None:
    try:
        path = rounded_path(waypoints, radius)
    except ValueError:
        return  # a repeated waypoint or a turn on the spot, which are refused
    distances = np.linspace(0, path.length, 400)
    poses = path.at(distances)
    steps = np.diff(poses.translation[:, :2], axis=0)
    step = distances[1]
    assert np.all(np.linalg.norm(steps, axis=1) < step * (1 + 1e-6))
    forward = np.column_stack([np.cos(poses.heading), np.sin(poses.heading)])
    # Within a step an arc of a short leg may turn far; on the whole the robot looks ahead.
    ahead = np.sum(steps * forward[:-1], axis=1) / step
    assert np.median(ahead) > 0.9


def test_repeated_waypoints_and_turns_on_the_spot_are_refused() -> None:
    with pytest.raises(ValueError, match="same"):
        rounded_path([[0, 0], [0, 0], [1, 0]], 0.5)
    with pytest.raises(ValueError, match="turns back"):
        rounded_path([[0, 0], [1, 0], [0, 0]], 0.5)


def test_a_drive_stands_speeds_up_drives_on_and_stands() -> None:
    drive = Drive(CORNER, speed=0.4, acceleration=0.4, start_s=3.0)
    times = np.arange(0, drive.end_s + 2, 0.01)
    travelled = np.linalg.norm(np.diff(drive.at(times).translation, axis=0), axis=1) / 0.01
    assert np.all(travelled[times[:-1] < 2.99] == 0)
    assert np.all(travelled[times[:-1] > drive.end_s] < 1e-9)
    cruising = (times[:-1] > 4.01) & (times[:-1] < drive.end_s - 1.02)
    assert np.allclose(travelled[cruising], 0.4, atol=1e-4)
    assert np.allclose(drive.at(drive.end_s).translation, [2, 2, 0])


def test_a_short_path_never_reaches_full_speed() -> None:
    path = rounded_path([[0, 0], [0.1, 0]], 0.5)
    drive = Drive(path, speed=0.4, acceleration=0.4, start_s=0.0)
    assert np.allclose(drive.at(drive.end_s).translation, [0.1, 0, 0])
    assert drive.end_s == pytest.approx(2 * np.sqrt(0.1 / 0.4))
