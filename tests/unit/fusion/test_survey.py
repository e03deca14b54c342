"""A whole drive solved offline, against the truth and against its own covariance."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from drives import (
    EPOCH_NS,
    CameraPlan,
    Plan,
    RobotPlan,
    Session,
    circle,
    lab_cameras,
    lab_plan,
    looking_at,
    make_session,
    offline,
    pushed,
    standing,
    straight,
    turning,
)
from msgspec import structs
from scipy.stats import chi2

from trigpoint.clock import to_ns
from trigpoint.config import OdometryNoise
from trigpoint.fusion.inputs import load_known
from trigpoint.fusion.results import Results
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import is_positive_semidefinite
from trigpoint.messages import Message, Odometry, Sightings
from trigpoint.network import encode_network
from trigpoint.tools.simulation.targets import target_of

# One drive in a million is further off, either way, where the covariance is honest.
UNLIKELY = 1e-6

Messages = tuple[tuple[str, Message], ...]


def assert_honest(session: Session, results: Results, *, cameras: int = 3) -> None:
    """Every camera located, within 5 of its sigmas, and all together as their joint covariance
    says."""
    assert statuses(results) == dict.fromkeys(list(session.plan.cameras)[:cameras], "located")
    error = session.error(results)
    for name, camera in error.cameras.items():
        assert camera.sigmas < 5, name
    assert error.nees is not None
    freedom = 6 * len(error.cameras)
    low, high = chi2.ppf([UNLIKELY, 1 - UNLIKELY], freedom) / freedom
    assert low < error.nees < high
    assert_sound(results)


def assert_sound(results: Results) -> None:
    """Nothing in the network is not a number, and covariances are some."""
    assert_finite(json.loads(encode_network(results.network)))
    assert results.covariance.shape == (6 * len(results.network.located),) * 2
    if results.network.located:
        assert is_positive_semidefinite(results.covariance)


def assert_finite(value: object) -> None:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            assert_finite(item)
    elif isinstance(value, float):
        assert math.isfinite(value)


def statuses(results: Results) -> dict[str, str]:
    return {name: camera.status for name, camera in results.network.cameras.items()}


def changed(session: Session, **messages: Messages) -> Session:
    return replace(session, **messages)  # pyright: ignore[reportArgumentType]


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
    assert "fit alike" in record.undetermined[0]
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
    assert "fit alike" in results.network.cameras["c1"].undetermined[0]
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


# -- what the site lets be estimated --------------------------------------------------------------


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


# -- several robots, known cameras ----------------------------------------------------------------


def two_robots(seconds: float = 22.0) -> Session:
    """r2 carries another target, in an odometry frame of its own, half a round behind r1."""
    plan = lab_plan(seconds=seconds, picture_rate=1.0)
    other = structs.replace(target_of("charuco"), name="other")
    second = RobotPlan(circle(speed=0.35), other, map_from_odom=Pose.planar(0.0, 2.4, np.pi))
    return make_session(replace(plan, robots=plan.robots | {"r2": second}))


def test_two_robots_that_meet_only_cameras_make_one_map() -> None:
    session = two_robots()
    results = offline(session)
    assert_honest(session, results)
    for robot in ("r1", "r2"):
        stamps_ns, poses = results.trajectories[robot]
        end = session.map_from_base(robot, int(stamps_ns[-1]))
        # The end is a fraction of a second from a sighting of millimetres.
        assert np.abs(poses[-1].difference(end)).max() < 0.05
    frame = results.network.robots["r2"].map_from_odom
    assert frame is not None
    drift = session.truth["r2"][-1] @ session.plan.robots["r2"].way(np.array([22.0]))[0].inverse()
    assert np.abs(frame.pose.difference(drift)).max() < 0.05


def test_look_alike_targets_of_two_robots_are_left_out_by_name() -> None:
    session = two_robots(3.0)
    plain = session.inputs.targets
    inputs = replace(session.inputs, targets=dict.fromkeys(plain, plain["r1"]))
    pipeline = pushed(inputs, session.messages)
    assert pipeline.left_out["unknown_target"] > 0
    assert "2 robots carry" in pipeline.last_problem or "no robots" in pipeline.last_problem


@pytest.fixture(scope="module")
def known_session(
    charuco: Session, charuco_results: Results, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Session, Results]:
    """A second drive where c1 and c2 are known from the first, from another start; c3 is new."""
    folder = tmp_path_factory.mktemp("known")
    network = charuco_results.network
    without = dict(network.cameras)
    without["c3"] = structs.replace(
        without["c3"], status="unseen", map_from_camera=None, covariance=None
    )
    known = replace(
        charuco_results,
        network=structs.replace(network, cameras=without),
        covariance=charuco_results.covariance[:12, :12],
    )
    known.save(folder)
    robot = replace(charuco.plan.robots["r1"], map_from_odom=Pose.planar(0.9, 0.6, 0.8))
    session = make_session(replace(charuco.plan, robots={"r1": robot}, seed=7))
    load = load_known(folder, session.inputs.site)
    return replace(session, inputs=replace(session.inputs, known=load)), known


def test_known_cameras_stay_and_new_ones_are_added(
    known_session: tuple[Session, Results],
) -> None:
    session, known = known_session
    results = offline(session)
    assert_honest(session, results)
    for name in ("c1", "c2"):
        before, after = (r.network.cameras[name].position_sigma for r in (known, results))
        # A floor of 0.1 mm an axis is added to what was known.
        assert after < before + 2e-4


def test_robot_is_placed_by_the_first_sighting_of_a_known_camera(
    known_session: tuple[Session, Results],
) -> None:
    session, _ = known_session
    first = next(
        i
        for i, (n, m) in enumerate(session.messages)
        if n in ("c1", "c2") and isinstance(m, Sightings) and m.faces
    )
    stamp_ns = session.messages[first][1].stamp_ns  # pyright: ignore[reportAttributeAccessIssue]
    few = [item for item in session.messages[: first + 20] if isinstance(item[1], Odometry)]
    pipeline = pushed(session.inputs, (*few, session.messages[first]))
    found = pipeline.robot("r1")
    assert found is not None
    moment = found.stamp_ns
    assert moment >= stamp_ns
    error = found.map_from_base.difference(session.map_from_base("r1", moment))[[0, 1, 5]]
    inner = np.ix_([0, 1, 5], [0, 1, 5])
    assert np.sqrt(error @ np.linalg.solve(found.covariance[inner], error)) < 5


# -- wrong sightings ------------------------------------------------------------------------------


def disturbed(messages: Messages, change) -> Messages:
    """Messages with every picture's faces changed: `change` gets a random number and the faces."""
    random = np.random.default_rng(11)
    return tuple(
        (n, replace(m, faces=change(random, m.faces)) if isinstance(m, Sightings) else m)
        for n, m in messages
    )


def test_displaced_pictures_are_rejected_and_counted(charuco: Session) -> None:
    moved: list[int] = []

    def displace(random: np.random.Generator, faces):
        if not faces or random.random() > 0.07:
            return faces
        angle = random.uniform(0, 2 * np.pi)
        moved.extend([1] * len(faces))
        shift = np.float32(15) * np.array([np.cos(angle), np.sin(angle)], np.float32)
        return tuple(replace(face, pixels=face.pixels + shift) for face in faces)

    session = changed(charuco, messages=disturbed(charuco.messages, displace))
    results = offline(session)
    assert_honest(session, results)
    assert len(moved) >= 3
    assert sum(c.rejected for c in results.network.cameras.values()) == len(moved)


def test_a_displaced_face_costs_hardly_more_than_itself(charuco: Session) -> None:
    moved: list[int] = []

    def displace(random: np.random.Generator, faces):
        if len(faces) < 2 or random.random() > 0.15:
            return faces
        moved.append(1)
        first = replace(faces[0], pixels=faces[0].pixels + np.array([0, 15], np.float32))
        return (first, *faces[1:])

    session = changed(charuco, messages=disturbed(charuco.messages, displace))
    results = offline(session)
    assert_honest(session, results)
    assert len(moved) >= 3
    # Now and then the face beside it, which it has drawn off, goes too.
    rejected = sum(c.rejected for c in results.network.cameras.values())
    assert len(moved) <= rejected <= 1.5 * len(moved)


def test_single_wild_corners_cost_no_picture(charuco: Session) -> None:
    def scatter(random: np.random.Generator, faces):
        found = []
        for face in faces:
            pixels = face.pixels.copy()
            if random.random() < 0.3:
                pixels[random.integers(len(pixels))] += random.normal(0, 20, 2)
            found.append(replace(face, pixels=pixels))
        return tuple(found)

    wild = changed(charuco, messages=disturbed(charuco.messages, scatter))
    results = offline(wild)
    assert_honest(wild, results)
    assert sum(c.rejected for c in results.network.cameras.values()) == 0
    for camera in results.network.cameras.values():
        assert camera.reprojection_rms == pytest.approx(charuco.plan.sigma, rel=0.15)


def test_face_that_is_named_wrongly_is_rejected(charuco: Session) -> None:
    wrong: list[int] = []

    def misname(random: np.random.Generator, faces):
        if len(faces) != 1 or random.random() > 0.2:
            return faces
        wrong.append(1)
        return (replace(faces[0], face=(faces[0].face + 2) % 6),)

    session = changed(charuco, messages=disturbed(charuco.messages, misname))
    results = offline(session)
    assert wrong
    assert_honest(session, results)
    assert sum(c.rejected for c in results.network.cameras.values()) == len(wrong)


def lifted(session: Session, at_s: float) -> Session:
    """The robot's counters start anew at a moment, somewhere else."""
    jump = Pose.planar(2.0, -1.0, 2.5)
    stamp_ns = EPOCH_NS + to_ns(at_s)

    def moved() -> Iterator[tuple[str, Message]]:
        for node, m in session.messages:
            is_after = isinstance(m, Odometry) and m.stamp_ns > stamp_ns
            yield node, (replace(m, pose=jump @ m.pose) if is_after else m)  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]

    return replace(session, messages=tuple(moved()))


def test_jump_of_the_odometry_does_not_ruin_the_map(charuco: Session) -> None:
    session = lifted(charuco, 20.0)  # c1 sees it again afterwards
    pipeline = pushed(session.inputs, session.messages)
    assert pipeline.left_out["odometry_jumps"] == 1
    results = pipeline.results()
    assert_honest(session, results)
    _, poses = results.trajectories["r1"]
    assert np.abs(poses[-1].difference(session.truth["r1"][-1])).max() < 0.05


def test_camera_behind_a_jump_is_undetermined_and_no_place_is_made_up(charuco: Session) -> None:
    """c1 before the jump, c2 after it, and nothing that ties the two."""
    session, cut_ns = lifted(charuco, 7.0), EPOCH_NS + to_ns(7.0)
    kept = tuple(
        (n, m)
        for n, m in session.messages
        if isinstance(m, Odometry) or n == ("c1" if m.stamp_ns < cut_ns else "c2")
    )
    results = offline(replace(session, messages=kept))
    record = results.network.cameras["c2"]
    assert statuses(results) == {"c1": "located", "c2": "undetermined", "c3": "unseen"}
    assert "odometry jumped" in record.undetermined[0]
    assert (record.map_from_camera, record.covariance) == (None, None)
    assert_sound(results)
