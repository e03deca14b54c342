"""Cameras that hang otherwise than one would think: pushed along the floor, below it, and known
from before but moved since."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    CameraPlan,
    Plan,
    RobotPlan,
    circle,
    lab_cameras,
    make_session,
    offline,
    pushed,
    straight,
    with_moved,
)

from trigpoint.contract.messages import Sightings
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.map.network import CameraRecord
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.sight.targets import target_of


def assert_there(camera: CameraRecord, map_from_camera: Pose) -> None:
    assert camera.status == "located"
    assert camera.map_from_camera is not None
    error = camera.map_from_camera.pose.difference(map_from_camera)
    assert error @ np.linalg.solve(camera.covariance_matrix, error) < 6 * 5.0


def assert_noticed(cameras: dict[str, CameraPlan], pushed_to: Pose, *, seconds: float) -> None:
    """c1, pushed after a minute of a slow drive, is where it hangs then, and the others still."""
    robots = {"r1": RobotPlan(circle(speed=0.08), target_of("charuco"))}
    plan = Plan(cameras, robots, seconds=seconds, picture_rate=0.7)
    session = with_moved(make_session(plan), "c1", pushed_to, 60.0)
    network = pushed(session.inputs, session.messages).results().network
    assert_there(network.cameras["c1"], pushed_to)
    for name in ("c2", "c3"):
        assert_there(network.cameras[name], cameras[name].map_from_camera)


def test_camera_that_was_pushed_along_the_floor_is_noticed() -> None:
    """A robot in the plane can be thought to stand otherwise instead: for long that costs less."""
    cameras = lab_cameras(3)
    there = Pose.planar(0.15, 0.0, 0.0) @ cameras["c1"].map_from_camera
    turn = Pose.planar(0.0, 0.0, 0.03).rotation
    pushed_to = Pose(turn @ there.rotation, there.translation)
    assert_noticed(cameras, pushed_to, seconds=180.0)


@pytest.mark.parametrize(("push_m", "more"), [(0.03, ""), (0.07, 'intrinsics = "estimate"')])
def test_small_push_shows_by_what_two_cameras_see_together(push_m: float, more: str) -> None:
    """A robot could have slipped as far, but not as the other camera sees it meanwhile. Each was
    located where it no longer hangs, and c2 and c3 as far off, at 20 to 90 sigmas."""
    cameras = lab_cameras(3, more=more)
    old = cameras["c1"].map_from_camera
    pushed_to = Pose(old.rotation, old.translation + np.array([push_m, 0.0, 0.0]))
    assert_noticed(cameras, pushed_to, seconds=120.0)


def test_camera_below_the_floor_is_there_where_nothing_else_fits() -> None:
    eye = looking_at((1.9, 0.3, -0.1), (0.3, 0.0, 0.65))
    robots = {"r1": RobotPlan(straight(), target_of("charuco"))}
    plan = Plan({"c1": CameraPlan(eye)}, robots, seconds=4.0, picture_rate=4.0)
    assert_there(offline(make_session(plan)).network.cameras["c1"], eye)


def test_known_camera_that_may_have_been_moved_is_not_given_out() -> None:
    cameras = lab_cameras(2)
    old = cameras["c1"].map_from_camera
    turn = so3.exp(np.array([0.0046, 0.0, 0.0])) @ Pose.planar(0.0, 0.0, 0.1).rotation
    now = Pose(turn @ old.rotation, old.translation + np.array([0.6, 0.0, 0.0046]))
    robots = {"r1": RobotPlan(circle(), target_of("charuco"))}
    plan = Plan({**cameras, "c1": replace(cameras["c1"], map_from_camera=now)}, robots, seconds=6.0)
    session = make_session(plan)
    poses = {name: camera.map_from_camera for name, camera in cameras.items()}
    known = KnownCameras(poses, 1e6 * np.eye(12))
    network = pushed(replace(session.inputs, known=known), session.messages).results().network
    camera = network.cameras["c1"]
    assert camera.status == "undetermined"
    assert any("none of them holds all" in reason for reason in camera.undetermined)


def test_first_picture_of_a_known_camera_that_is_off_by_little_is_no_push() -> None:
    """Nothing but where it is known to be tells that the picture is wrong."""
    cameras = lab_cameras(2)
    old = cameras["c1"].map_from_camera
    off = Pose(old.rotation, old.translation + np.array([0.12, 0.0, 0.0]))
    robots = {"r1": RobotPlan(circle(), target_of("charuco"))}
    there = {**cameras, "c1": replace(cameras["c1"], map_from_camera=off)}
    session = make_session(Plan(there, robots, seconds=40.0, picture_rate=1.0))
    of_c1 = [m for node, m in session.messages if node == "c1" and isinstance(m, Sightings)]
    messages = tuple(each for each in session.messages if each[1] not in of_c1[1:])
    poses = {name: camera.map_from_camera for name, camera in cameras.items()}
    known = KnownCameras(poses, 1e6 * np.eye(12))
    network = pushed(replace(session.inputs, known=known), messages).results().network
    camera = network.cameras["c1"]
    assert camera.earlier == ()
    assert camera.rejected == camera.sightings
