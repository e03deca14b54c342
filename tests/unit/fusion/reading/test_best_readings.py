"""Held against the corners' projections, and a target's own outlines, one view after the other."""

import numpy as np
import pytest
from support.fusion.slow_readings import outermost, slow_rms_px

from trigpoint.fusion.model.observations import Reading, View, corners_in_base
from trigpoint.fusion.model.rolling_shutter import Sweep
from trigpoint.fusion.reading.best_readings import best_readings, readings_rms_px
from trigpoint.geometry import CameraModel, Pose
from trigpoint.site.target import Target
from trigpoint.tools.simulation.sight.targets import target_of

LENS = CameraModel.from_field_of_view(640, 480, np.radians(60.0))


def random_view(target: Target, random: np.random.Generator) -> View:
    face = int(random.integers(len(target.faces)))
    count = int(random.integers(1, target.faces[face].corner_count + 1))
    corners = np.sort(random.choice(target.faces[face].corner_count, count, replace=False))
    pixels = random.uniform(0.0, 480.0, (count, 2))
    if random.random() < 0.2:
        pixels = np.round(pixels, -2)  # corners that reach equally far
    other = Reading((face + 1) % len(target.faces), bool(random.random() < 0.5))
    readings = (Reading(face), Reading(face, is_turned=True), other)[: random.integers(1, 4)]
    sweep = None
    if random.random() < 0.3:
        sweep = Sweep(random.normal(0.0, 0.01, count), random.normal(size=6))
    return View(corners, pixels, 0.2, readings, sweep)


def best_reading(view: View, target: Target, camera_from_base: Pose) -> tuple[Reading, float]:
    """The reading of least RMS for a pose, and that."""
    rms = slow_rms_px(view, target, LENS, camera_from_base)
    best = int(np.argmin(rms))
    return view.readings[best], float(rms[best])


@pytest.mark.parametrize("kind", ["charuco", "checkerboard"])
def test_many_views_are_read_as_each_by_itself(kind: str) -> None:
    target, random = target_of(kind), np.random.default_rng(2)
    views = [random_view(target, random) for _ in range(300)]
    vectors = random.normal(0.0, [0.6, 0.6, 0.6, 1.5, 1.5, 1.5], (300, 6))
    poses = Pose.from_vector(vectors + np.eye(6)[2])
    readings, rms = best_readings(views, target, LENS, poses)
    expected = [best_reading(view, target, poses[row]) for row, view in enumerate(views)]
    assert readings == [reading for reading, _ in expected]
    np.testing.assert_allclose(rms, [each for _, each in expected], rtol=1e-9)
    assert 20 < np.sum(np.isfinite(rms)) < 280  # both happen


def test_every_reading_has_its_own_misfit() -> None:
    target, random = target_of("checkerboard"), np.random.default_rng(5)
    views = [random_view(target, random) for _ in range(40)]
    poses = Pose.from_vector(random.normal(0.0, 0.6, (40, 6)) + 2 * np.eye(6)[2])
    numbers, rms = readings_rms_px(views, target, LENS, poses)
    expected = [slow_rms_px(view, target, LENS, poses[row]) for row, view in enumerate(views)]
    np.testing.assert_allclose(rms, np.concatenate(expected), rtol=1e-9)
    np.testing.assert_array_equal(numbers, [int(np.argmin(each)) for each in expected])


def test_turned_reading_names_corners_from_the_other_end() -> None:
    target = target_of("checkerboard")
    corners = np.array([0, 3, 7])
    both = (Reading(2), Reading(2, is_turned=True))
    view = View(corners, np.zeros((3, 2)), 0.2, both)
    upright, turned = (corners_in_base(view, reading, target) for reading in both)
    on_face = target.faces[2].base_from_face @ target.faces[2].corners
    np.testing.assert_array_equal(upright, on_face[corners])
    np.testing.assert_array_equal(turned, on_face[::-1][corners])


def test_outermost_corners_are_each_named_once() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])
    np.testing.assert_array_equal(outermost(square), [0, 1, 2, 3])
    np.testing.assert_array_equal(outermost(square[:1]), [0])
