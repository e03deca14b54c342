"""A whole drive solved offline, against the truth and against its own covariance."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    CameraPlan,
    Session,
    lab_plan,
    make_session,
    offline,
    pushed,
    standing,
    straight,
    turning,
)
from support.fusion.honesty import Messages, assert_honest, assert_sound, changed, statuses

from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.fusion.estimators.results import Results
from trigpoint.geometry import Pose
from trigpoint.map.network import encode_network
from trigpoint.testing.views import looking_at

# -- the plain drive ------------------------------------------------------------------------------


def test_every_camera_is_found_where_it_is(session: Session, results: Results) -> None:
    assert_honest(session, results)


def test_residuals_are_those_of_the_noise(session: Session, results: Results) -> None:
    statistic = results.network.statistics.chi2_per_dof
    assert statistic is not None
    numbers = 2 * sum(
        len(face.corners)
        for _, m in session.messages
        if isinstance(m, Sightings)
        for face in m.faces
    )
    # χ² over its degrees of freedom has a sigma of √(2/dof); five of them.
    assert abs(statistic - 1) < 5 * math.sqrt(2 / numbers)
    for camera in results.network.cameras.values():
        assert camera.rejected == 0
        assert camera.reprojection_rms == pytest.approx(session.plan.sigma, rel=0.1)


def test_sightings_of_each_camera_are_counted(session: Session, results: Results) -> None:
    for name, camera in results.network.cameras.items():
        pictures = [m for node, m in session.messages if node == name and isinstance(m, Sightings)]
        assert camera.sightings == sum(len(picture.faces) for picture in pictures)


def test_trajectory_follows_the_robot_at_every_odometry_message(
    session: Session, results: Results
) -> None:
    stamps_ns, poses = results.trajectories["r1"]
    odometry = [m.stamp_ns for _, m in session.messages if isinstance(m, Odometry)]
    assert stamps_ns.tolist() == odometry
    truth = session.truth["r1"][::2]
    error = poses.difference(truth)
    # The way of 9 m is held to the first pose by odometry: 6 mm and 4 mrad per root of a metre.
    assert np.linalg.norm(error[:, :3], axis=1).max() < 5 * (0.006 * 3 + 0.004 * 3 * 2.4)
    # Much closer than dead reckoning at the end, where cameras that were met before see it.
    reported = [m.pose for _, m in session.messages if isinstance(m, Odometry)][-1]
    drift = np.linalg.norm(reported.translation - truth[-1].translation)
    assert np.linalg.norm(error[-1, :3]) < drift / 2


def test_map_begins_at_the_first_robots_first_pose(session: Session, results: Results) -> None:
    _, poses = results.trajectories["r1"]
    np.testing.assert_allclose(poses[0].difference(session.truth["r1"][0]), 0.0, atol=1e-5)


def test_two_runs_give_the_same_bytes(charuco: Session, charuco_results: Results) -> None:
    again = offline(charuco)
    assert encode_network(again.network) == encode_network(charuco_results.network)
    np.testing.assert_array_equal(again.covariance, charuco_results.covariance)


def test_solving_once_more_changes_nothing(charuco: Session, charuco_results: Results) -> None:
    pipeline = pushed(charuco.inputs, charuco.messages)
    pipeline.finish()
    first, again = charuco_results.network, pipeline.results().network
    for name in first.located:
        sigma = np.sqrt(np.diagonal(first.cameras[name].covariance_matrix))
        apart = pose_of(again, name).difference(pose_of(first, name)) / sigma
        np.testing.assert_allclose(apart, 0.0, atol=0.05)


def pose_of(network, name: str) -> Pose:
    return network.cameras[name].map_from_camera.pose


def test_half_the_pictures_make_it_less_sure(charuco: Session, charuco_results: Results) -> None:
    fewer = make_session(replace(charuco.plan, picture_rate=1.0))
    results = offline(fewer)
    assert_honest(fewer, results)
    for name, camera in results.network.cameras.items():
        assert camera.position_sigma > charuco_results.network.cameras[name].position_sigma


# -- what the data do not say ---------------------------------------------------------------------


def test_camera_that_never_saw_the_robot_is_unseen(charuco: Session) -> None:
    away = CameraPlan(looking_at((9.0, 9.0, 1.5), (12.0, 12.0, 0.0)))
    session = make_session(replace(charuco.plan, cameras=charuco.plan.cameras | {"c4": away}))
    results = offline(session)
    record = results.network.cameras["c4"]
    assert (record.status, record.sightings, record.map_from_camera) == ("unseen", 0, None)
    assert results.network.located == ["c1", "c2", "c3"]


def only_once(messages: Messages, camera: str) -> Messages:
    """The pictures of one camera but for the middle one of those that show something."""
    shown = [m for n, m in messages if n == camera and isinstance(m, Sightings) and m.faces]
    keep = shown[len(shown) // 2]
    return tuple(
        (n, m) for n, m in messages if n != camera or not isinstance(m, Sightings) or m is keep
    )


def test_camera_that_saw_one_look_alike_face_is_undetermined_in_words(
    checkerboard: Session,
) -> None:
    results = offline(changed(checkerboard, messages=only_once(checkerboard.messages, "c2")))
    record = results.network.cameras["c2"]
    assert (record.status, record.sightings) == ("undetermined", 2)
    assert "none of them holds all" in record.undetermined[0]
    assert record.map_from_camera is None
    assert record.covariance is None
    assert results.network.located == ["c1", "c3"]
    assert_sound(results)


def test_camera_that_saw_marked_faces_once_is_located_and_less_sure(
    charuco: Session, charuco_results: Results
) -> None:
    session = changed(charuco, messages=only_once(charuco.messages, "c2"))
    results = offline(session)
    assert_honest(session, results)
    once, often = (r.network.cameras["c2"].position_sigma for r in (results, charuco_results))
    assert once > 2 * often


@pytest.mark.parametrize(
    "way", [standing(), turning(), straight()], ids=["stands", "turns", "runs"]
)
def test_marked_faces_locate_a_camera_whatever_the_robot_does(charuco: Session, way) -> None:
    robots = {"r1": replace(charuco.plan.robots["r1"], way=way)}
    session = make_session(replace(charuco.plan, robots=robots, seconds=6.0))
    results = offline(session)
    assert statuses(results) == {"c1": "located", "c2": "unseen", "c3": "unseen"}
    assert session.error(results).cameras["c1"].sigmas < 5
    assert_sound(results)


def test_look_alikes_on_the_spot_leave_the_camera_undetermined(checkerboard: Session) -> None:
    # Faces 60° apart and a robot that stays where it is: the camera may be on either of its sides.
    robots = {"r1": replace(checkerboard.plan.robots["r1"], way=turning())}
    session = make_session(replace(checkerboard.plan, robots=robots, seconds=2.5))
    results = offline(session)
    assert statuses(results) == {"c1": "undetermined", "c2": "unseen", "c3": "unseen"}
    assert "none of them holds all" in results.network.cameras["c1"].undetermined[0]
    assert_sound(results)


def test_session_without_sightings_has_an_unseen_network(charuco: Session) -> None:
    odometry = tuple((n, m) for n, m in charuco.messages if isinstance(m, Odometry))
    results = offline(changed(charuco, messages=odometry))
    assert set(statuses(results).values()) == {"unseen"}
    assert results.network.statistics.chi2_per_dof is None
    assert len(results.trajectories["r1"][0]) == len(odometry)
    assert_sound(results)


def test_session_without_anything_has_no_map() -> None:
    results = offline(changed(make_session(lab_plan(seconds=0.0)), messages=()))
    assert results.network.map_id == ""
    assert results.network.robots["r1"].map_from_odom is None
    assert_sound(results)
