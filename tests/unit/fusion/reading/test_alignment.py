"""A robot's pose before a located camera, by one picture and what was known before."""

import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.fusion.model.observations import Observation, Reading, View, observation_of
from trigpoint.fusion.reading.alignment import Alignment, PosePrior, align
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.tools.simulation.sight.targets import target_of

LENS = CameraModel.from_field_of_view(640, 480, np.radians(60.0))
TARGET = target_of("charuco")
PLANAR = [0, 1, 5]
SIGMA_PX = 0.2
# 2.5 m behind the robot, a metre above it, looking at its back.
MAP_FROM_CAMERA = Pose(
    np.array([[0.0, -0.3, 0.954], [-1.0, 0.0, 0.0], [0.0, -0.954, -0.3]]), np.array([-2.5, 0, 1.2])
)
HERE = Pose.planar(0.3, -0.2, 0.1)
PRIOR = PosePrior(HERE, np.diag([4e-4, 4e-4, 1e-8, 1e-8, 1e-8, 4e-4]))


def face_before_the_camera() -> int:
    """The face that looks most at the camera."""
    towards = MAP_FROM_CAMERA.translation - HERE.translation
    normals = [(HERE @ face.base_from_face).rotation[:, 2] @ towards for face in TARGET.faces]
    return int(np.argmin(normals))


def points_of(face: int) -> Array:
    return TARGET.faces[face].base_from_face @ TARGET.faces[face].corners


def seen(at: Pose, *, noise_px: float = 0.0) -> Observation:
    """A picture of all corners of one face."""
    face = face_before_the_camera()
    points = (MAP_FROM_CAMERA.inverse() @ at) @ points_of(face)
    pixels = LENS.project(points)
    pixels = pixels + noise_px * np.random.default_rng(4).normal(size=pixels.shape)
    view = View(np.arange(len(points)), pixels, SIGMA_PX, (Reading(face),))
    return observation_of("c1", "r1", 0, (view,))


def aligned(observation: Observation, prior: PosePrior | None) -> Alignment:
    found = align(
        observation, TARGET, LENS, MAP_FROM_CAMERA, tangent=PLANAR, prior=prior, extra_sigma_px=0.0
    )
    assert found is not None
    return found


def cost_at(observation: Observation, pose: Pose) -> float:
    """χ² of the corners and the prior, written out."""
    [view] = observation.views
    points = (MAP_FROM_CAMERA.inverse() @ pose) @ points_of(view.readings[0].face)
    apart = pose.difference(PRIOR.map_from_base)[PLANAR]
    held = np.linalg.inv(PRIOR.covariance[np.ix_(PLANAR, PLANAR)])
    corners = np.sum((LENS.project(points) - view.pixels) ** 2) / SIGMA_PX**2
    return float(corners + apart @ held @ apart)


@pytest.mark.parametrize("prior", [PRIOR, None])
def test_robot_is_where_its_corners_are_seen(prior: PosePrior | None) -> None:
    at = HERE.disturbed(np.array([0.01, -0.015, 0, 0, 0, 0.01]))
    weak = prior and replace(prior, covariance=1e4 * prior.covariance)
    found = aligned(seen(at), weak)
    np.testing.assert_allclose(found.map_from_base.difference(at), 0.0, atol=1e-4)


def test_pose_is_the_least_of_corners_and_prior_together() -> None:
    observation = seen(HERE.disturbed(np.array([0.02, 0.01, 0, 0, 0, -0.01])), noise_px=SIGMA_PX)
    found = aligned(observation, PRIOR)
    least = cost_at(observation, found.map_from_base)
    assert found.cost == pytest.approx(least, rel=1e-6)
    for axis in PLANAR:
        for step in (-1e-3, 1e-3):
            other = found.map_from_base.disturbed(step * np.eye(6)[axis])
            assert cost_at(observation, other) > least


def test_corners_that_lie_elsewhere_are_left_out_and_the_others_say_where_the_robot_is() -> None:
    at = HERE.disturbed(np.array([0.01, -0.015, 0, 0, 0, 0.01]))
    observation = seen(at)
    [view] = observation.views
    pixels, is_sound = view.pixels.copy(), np.ones(len(view.pixels), dtype=bool)
    pixels[[1, 5]] += 9.0
    is_sound[[1, 5]] = False
    found = aligned(replace(observation, views=(replace(view, pixels=pixels),)), PRIOR)
    np.testing.assert_array_equal(found.wild, ~is_sound)
    others = replace(view, corners=view.corners[is_sound], pixels=view.pixels[is_sound])
    alone = aligned(replace(observation, views=(others,)), PRIOR)
    apart = found.map_from_base.difference(alone.map_from_base)
    np.testing.assert_allclose(apart, 0.0, atol=1e-5)
