"""What the site lets be estimated beside the cameras' poses: offsets, scales, lenses, faces, and a
target that moves in space."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import (
    Plan,
    RobotPlan,
    circle,
    lab_cameras,
    lab_plan,
    make_session,
    offline,
)
from support.fusion.honesty import assert_honest

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise
from trigpoint.tools.simulation.sight.targets import target_of


def uneven(*, radius: float = 1.2) -> object:
    """Around the circle, now fast and now slow, so that a moment tells a place."""

    def at(seconds: Array) -> Pose:
        arc = 0.4 * seconds + 0.25 * (1 - np.cos(1.6 * seconds)) / 1.6
        turn = arc / radius
        return Pose.planar(radius * np.sin(turn), radius * (1 - np.cos(turn)), turn)

    return at


def test_time_offsets_are_found() -> None:
    true: dict[str, float] = {"c1": 0.03, "c2": -0.05, "c3": 0.02}
    cameras = {
        name: replace(camera, time_offset_s=true[name], more="time_offset_sigma = 0.05")
        for name, camera in lab_cameras().items()
    }
    robots = {"r1": RobotPlan(uneven(), target_of("charuco"))}  # pyright: ignore[reportArgumentType]
    session = make_session(lab_plan(cameras=cameras, robots=robots))
    results = offline(session)
    assert_honest(session, results)
    for name, offset_s in true.items():
        record = results.network.cameras[name]
        assert record.time_offset_sigma < 0.025  # half of what was known before, or better
        assert abs(record.time_offset - offset_s) < 5 * record.time_offset_sigma


def test_odometry_scales_are_found() -> None:
    noise = OdometryNoise(distance_scale=0.1, heading_scale=0.1)
    robot = RobotPlan(circle(), target_of("charuco"), noise, scales=(0.06, -0.05))
    session = make_session(lab_plan(robots={"r1": robot}))
    results = offline(session)
    assert_honest(session, results)
    found = results.network.robots["r1"]
    # The way of 9 m is known to 2 cm by its random walk, the turn of 7 rad to 20 mrad: 0.3 %.
    assert found.distance_scale == pytest.approx(1.06, abs=5 * 0.003)
    assert found.heading_scale == pytest.approx(0.95, abs=5 * 0.003)


def test_lenses_are_found() -> None:
    nominal = CameraModel.from_field_of_view(640, 480, np.radians(58.0))
    cameras = {
        name: replace(camera, told=nominal, more='intrinsics = "estimate"')
        for name, camera in lab_cameras().items()
    }
    session = make_session(lab_plan(cameras=cameras))
    results = offline(session)
    assert_honest(session, results)
    for name, camera in cameras.items():
        record = results.network.cameras[name].intrinsics
        assert record is not None
        sigma = np.array(
            [*[getattr(record.sigma, key) for key in ("fx", "fy", "cx", "cy")], *record.sigma.d]
        )
        assert np.all(sigma[:4] < [5.0, 5.0, 10.0, 10.0])
        error = (record.camera.parameters - camera.lens.parameters) / sigma
        assert np.abs(error).max() < 5


def test_faces_that_sit_a_little_off_are_found() -> None:
    random, true = np.random.default_rng(2), target_of("charuco")
    shaken = []
    for face in true.faces:
        pose = face.base_from_face.disturbed(random.normal(0, np.repeat([0.003, 0.005], 3)))
        place = tuple(float(v) for v in pose.translation), tuple(float(v) for v in pose.quaternion)
        shaken.append(structs.replace(face, translation=place[0], quaternion=place[1]))
    wrong = structs.replace(true, faces=tuple(shaken))
    session = make_session(
        lab_plan(more="[fusion]\ntarget_translation = 0.003\ntarget_rotation = 0.005")
    )
    session = replace(session, inputs=replace(session.inputs, targets={"r1": wrong}))
    results = offline(session)
    assert_honest(session, results)
    found = results.network.robots["r1"].target.faces
    before = [
        np.linalg.norm(np.subtract(w.translation, t.translation))
        for w, t in zip(shaken, true.faces, strict=True)
    ]
    after = [
        np.linalg.norm(np.subtract(f.translation, t.translation))
        for f, t in zip(found, true.faces, strict=True)
    ]
    assert np.mean(after) < np.mean(before)


def arm(seconds: Array) -> Pose:
    """A target on an arm, in space."""
    swing, nod = 0.25 * np.sin(0.7 * seconds), 0.3 * (np.sin(0.5 * seconds + 1) - np.sin(1.0))
    turns = np.stack([swing, nod, 0.4 * seconds], axis=-1)
    x, y = 0.5 * np.sin(0.4 * seconds), 0.5 * (1 - np.cos(0.4 * seconds))
    return Pose(so3.exp(turns), np.stack([x, y, 0.15 * np.sin(0.9 * seconds)], axis=-1))


def test_target_on_an_arm_locates_cameras_by_its_motion_in_space() -> None:
    noise = OdometryNoise(vertical=0.003, tilt=0.003, tilt_turn=0.004)
    robot = RobotPlan(arm, target_of("charuco"), noise, planar=False)
    session = make_session(Plan(lab_cameras(radius=0.5), {"r1": robot}, picture_rate=1.0))
    assert_honest(session, offline(session))
