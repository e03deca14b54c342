"""Corners that a rolling shutter saw, held against the robot's way while its rows were exposed."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.small_problems import SIGMA, first_state, small_data, true_pose

from trigpoint.base.clock import to_ns
from trigpoint.fusion.model.assembly import assemble
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import (
    Observation,
    Reading,
    View,
    base_from_faces,
    corners_in_base,
    observation_of,
    points_of,
)
from trigpoint.fusion.model.rolling_shutter import sweep_of
from trigpoint.fusion.solver.levenberg_marquardt import linearise
from trigpoint.geometry import rotation as so3
from trigpoint.site.config import CameraConfig
from trigpoint.tools.simulation.sight.targets import target_of

LINE_DELAY_S = 1e-4
SLOW_S = 3e-4
ROLLING = CameraConfig("sim://c1", line_delay=LINE_DELAY_S)


def seen_in(camera: CameraConfig, *rows: float) -> Observation:
    """Two corners of one face a row, one view a row."""
    views = []
    for face, row in enumerate(rows):
        pixels = np.array([[100.0, row], [200.0, row]])
        views.append(
            View(np.array([0, 1]), pixels, 0.1, (Reading(face),), sweep_of(camera, pixels))
        )
    return observation_of("c1", "r1", 10**9, tuple(views))


def test_an_observation_is_of_the_moment_when_the_middle_of_its_corners_was_exposed() -> None:
    observation = seen_in(ROLLING, 339.5, 439.5)
    assert observation.stamp_ns == 10**9 + to_ns(150 * LINE_DELAY_S)
    for view, rows_off in zip(observation.views, (-50, 50), strict=True):
        assert view.sweep is not None
        np.testing.assert_allclose(view.sweep.after_s, rows_off * LINE_DELAY_S, atol=1e-9)


def test_taken_anew_it_stays_of_its_moment() -> None:
    once = seen_in(ROLLING, 30.0, 101.0)
    again = observation_of("c1", "r1", once.stamp_ns, once.views)
    assert again.stamp_ns == once.stamp_ns


def test_a_shutter_that_opens_everywhere_at_once_leaves_no_trace() -> None:
    observation = seen_in(CameraConfig("sim://c1"), 10.0, 400.0)
    assert observation.stamp_ns == 10**9
    assert not observation.is_swept


@pytest.mark.parametrize("is_turned", [False, True])
def test_every_reading_is_swept_as_the_robot_moves(is_turned: bool) -> None:
    target, pixels = target_of("checkerboard"), np.array([[5.0, 0.0], [9.0, 200.0], [9.0, 400.0]])
    readings = (Reading(0, is_turned), Reading(3, is_turned))
    view = View(np.array([0, 1, 7]), pixels, 0.1, readings, sweep_of(ROLLING, pixels))
    observation = observation_of("c1", "r1", 0, (view,)).moving(np.array([0.4, 0, 0, 0, 0, 0.9]))
    for reading in readings:
        swept = corners_in_base(observation.views[0], reading, target)
        still = corners_in_base(view, reading, target)
        points = points_of(observation.read_as((reading,)), target)
        np.testing.assert_allclose(points.in_base(base_from_faces(target)), swept)
        apart = swept - still
        speed = np.array([0.4, 0, 0]) + np.cross([0, 0, 0.9], still)
        np.testing.assert_allclose(apart, np.array([-200, 0, 200])[:, None] * 1e-4 * speed)


def rms_px_at_the_truth(data: DataSet) -> float:
    assembled = assemble(data, first_state(data), list(range(len(data.entries))))
    cost = linearise(assembled.problem, assembled.start).cost
    count = 2 * sum(entry.observation.corner_count for entry in data.entries)
    return SIGMA * float(np.sqrt(cost / count))


def test_at_the_truth_nothing_is_left_over_in_the_plane_or_off_it() -> None:
    # Pixels: what the second order leaves.
    assert rms_px_at_the_truth(small_data(line_delay_s=SLOW_S)) < 1e-4


def test_taken_for_a_global_one_a_rolling_shutter_is_off() -> None:
    data = small_data(line_delay_s=SLOW_S)
    for entry in data.entries:
        still = tuple(replace(view, sweep=None) for view in entry.observation.views)
        entry.observation = replace(entry.observation, views=still)
    assert rms_px_at_the_truth(data) > 0.03


@pytest.mark.parametrize("robot", ["r1", "r2"])
def test_a_robots_twist_is_its_odometrys_at_the_true_time(robot: str) -> None:
    data = small_data(line_delay_s=SLOW_S)
    entries = [e.observation for e in data.entries if e.observation.is_swept]
    observation = next(o for o in entries if o.robot == robot)
    scales, step_ns = np.array([0.02, -0.03]), 1_000_000
    for later_ns in (0, 300_000_000):
        at_ns = observation.stamp_ns + later_ns
        sweep = data.moving(observation, at_ns, scales).views[0].sweep
        before, after = (true_pose(data, robot, at_ns + n) for n in (-step_ns, step_ns))
        apart = before.inverse() @ after
        expected = np.concatenate([apart.translation, so3.log(apart.rotation)]) / 2e-3
        assert sweep is not None
        np.testing.assert_allclose(sweep.twist, expected * np.repeat(1 + scales, 3), atol=1e-3)
