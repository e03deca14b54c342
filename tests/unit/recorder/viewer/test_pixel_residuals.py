"""What a sighting is off, by where robot and camera are said to be."""

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from trigpoint.contract.messages import FaceSighting, PoseEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.uncertainty import planar_covariance
from trigpoint.recorder.viewer.pixel_residuals import Eye, Residual, RobotTrack, residual_of
from trigpoint.site.target import Target, parse_target

START_NS = 1_760_000_000_000_000_000
SIGMA_M = 0.02
MOMENT_S = 2.52


def track(lab: Any, *, robot_sigma_m: float = SIGMA_M) -> RobotTrack:
    """The robot's corrected poses, ten a second, none at the moment of a picture."""
    found = RobotTrack()
    for t in np.arange(0.0, 5.0, 0.1):
        covariance = planar_covariance(np.diag([robot_sigma_m**2, robot_sigma_m**2, 1e-6]))
        stamp_ns = START_NS + round(1e9 * float(t))
        found.add(PoseEstimate(stamp_ns, "map", lab.map_from_base(float(t)), covariance))
    return found


def eye(lab: Any, camera: str = "c1", *, offset_sigma_s: float = 0.0) -> Eye:
    estimate = PoseEstimate(START_NS, "map", lab.poses[camera], 1e-6 * np.eye(6))
    return Eye(estimate, lab.lens, offset_sigma_s)


def seen(lab: Any, camera: str = "c1", t: float = MOMENT_S) -> FaceSighting:
    faces = lab.sighted(camera, t)
    assert faces, "the drawn session has no face there"
    return faces[0]


def off(
    lab: Any,
    face: FaceSighting,
    *,
    t: float = MOMENT_S,
    target: Target | None = None,
    robot: RobotTrack | None = None,
    camera: Eye | None = None,
) -> Residual | None:
    stamp_ns = START_NS + round(1e9 * t)
    robots, targets = {"r1": robot or track(lab)}, {"r1": target or lab.target}
    return residual_of(face, stamp_ns, camera or eye(lab), robots, targets)


def test_a_sound_sighting_is_where_it_should_be(lab: Any) -> None:
    found = off(lab, seen(lab))
    assert found is not None
    assert found.off_px < 0.3  # the pose is taken between two of the robot's
    assert not found.contradicts


def test_one_that_is_further_off_than_the_poses_explain_contradicts(lab: Any) -> None:
    face = seen(lab)
    moved = replace(face, pixels=face.pixels + np.array([60, 0], np.float32))
    found = off(lab, moved)
    assert found is not None
    assert found.off_px == pytest.approx(60, abs=1)
    assert found.contradicts
    # A robot that is not known better than to some decimetres explains it.
    unsure = off(lab, moved, robot=track(lab, robot_sigma_m=0.3))
    assert unsure is not None
    assert not unsure.contradicts


def test_a_camera_whose_clock_is_unknown_explains_what_a_moving_robot_is_off(lab: Any) -> None:
    late = seen(lab, t=MOMENT_S - 0.2)
    sharp = track(lab, robot_sigma_m=0.001)
    assert (found := off(lab, late, robot=sharp)) is not None
    assert found.contradicts
    found = off(lab, late, robot=sharp, camera=eye(lab, offset_sigma_s=0.2))
    assert found is not None
    assert not found.contradicts


def test_nothing_is_said_without_a_pose_of_that_moment(lab: Any) -> None:
    assert off(lab, seen(lab), t=20.0) is None


def test_another_robots_target_is_not_taken(lab: Any) -> None:
    assert off(lab, replace(seen(lab), target="other")) is None


BOARD = """name = "board"
[[faces]]
id = 0
pattern = "checkerboard"
columns = 7
rows = 5
square = 0.08
translation = [0.15, 0.2, 0.6]
quaternion = [0.5, -0.5, -0.5, 0.5]
"""


def test_a_board_that_reads_from_both_ends_is_read_the_better_way(lab: Any) -> None:
    target = parse_target(BOARD)
    face = target.faces[0]
    points = lab.map_from_base(MOMENT_S) @ face.base_from_face @ face.corners
    camera = eye(lab)
    camera.estimate = replace(camera.estimate, pose=_facing(points))
    pixels = lab.lens.project(camera.estimate.pose.inverse() @ points).astype(np.float32)
    ids = np.arange(face.corner_count, dtype=np.uint16)
    found = off(
        lab, FaceSighting("", -1, ids[::-1].copy(), pixels, 0.1), target=target, camera=camera
    )
    assert found is not None
    assert found.off_px < 0.3
    assert np.max(np.linalg.norm(found.seen - found.expected, axis=1)) < 1.0


def _facing(points: np.ndarray) -> Pose:
    """A camera two metres before the middle of a board, which looks at it."""
    middle = points.mean(axis=0)
    right = points[1] - points[0]
    right = right / np.linalg.norm(right)
    down = points[-1] - points[0]
    down = down - (down @ right) * right
    down = down / np.linalg.norm(down)
    ahead = np.cross(right, down)
    return Pose(np.stack([right, down, ahead], axis=1), middle - 2.0 * ahead)
