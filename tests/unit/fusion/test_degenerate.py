"""Sessions that tell too little: what is not known is said in words, and no pose is made up."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import (
    EPOCH_NS,
    CameraPlan,
    Plan,
    RobotPlan,
    Sent,
    Session,
    circle,
    lab_cameras,
    lab_plan,
    make_session,
    offline,
    pushed,
    standing,
    straight,
    turning,
)

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.fusion.estimators.results import Results
from trigpoint.geometry import Pose
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.sight.targets import target_of

# A pose that is this many of its sigmas off in any direction is a confident wrong one: a normal
# error is so with 3e-7.
_WRONG_SIGMAS = 5.0
_EYE = looking_at((2.2, -1.4, 1.5), (0.3, 0.0, 0.65))
_AHEAD = looking_at((3.5, 0.0, 1.2), (0.0, 0.0, 0.65))  # the robot drives straight towards it


def assert_sound(session: Session, results: Results) -> None:
    """No number is none, nothing located is wrong, and what is not located says why."""
    assert np.all(np.isfinite(results.covariance))
    for name, camera in results.network.cameras.items():
        if camera.status == "located":
            assert camera.map_from_camera is not None
            assert camera.covariance is not None
            true = session.plan.cameras[name].map_from_camera
            error = camera.map_from_camera.pose.difference(true)
            covariance = np.reshape(camera.covariance, (6, 6))
            assert np.all(np.isfinite(covariance))
            sigmas = np.abs(error) / np.sqrt(np.diagonal(covariance) + 1e-8)
            assert sigmas.max() < _WRONG_SIGMAS, (name, sigmas)
        else:
            assert camera.map_from_camera is None
            assert camera.undetermined or camera.status == "unseen"
    for _, way in results.trajectories.values():
        assert np.all(np.isfinite(way.translation))


def cut(session: Session, seconds: float) -> Session:
    """Its first seconds."""
    last_ns = EPOCH_NS + to_ns(seconds)
    return replace(session, messages=tuple(m for m in session.messages if m[1].stamp_ns <= last_ns))


def with_pictures(session: Session, count: int, *, faces: int = 9) -> Session:
    """With so many pictures of each camera that show the robot, and at most so many faces each."""
    kept: list[tuple[str, Sent]] = []
    left = dict.fromkeys(session.plan.cameras, count)
    for node, message in session.messages:
        if isinstance(message, Sightings):
            if not message.faces or not left[node]:
                continue
            left[node] -= 1
            largest = sorted(message.faces, key=lambda f: -float(np.ptp(f.pixels[:, 0])))[:faces]
            kept.append((node, replace(message, faces=tuple(largest))))
        else:
            kept.append((node, message))
    return replace(session, messages=tuple(kept))


def one_robot(target: str, way, eye: Pose = _EYE, **changes) -> Session:
    robot = RobotPlan(way, target_of(target))
    return make_session(Plan({"c1": CameraPlan(eye)}, {"r1": robot}, **changes))


@pytest.mark.parametrize("target", ["charuco", "checkerboard"])
@pytest.mark.parametrize("eye", [_EYE, _AHEAD], ids=["beside", "ahead"])
@pytest.mark.parametrize(
    "way", [standing(), turning(), straight()], ids=["stands", "turns", "drives straight"]
)
def test_robot_that_shows_little_gives_no_wrong_pose(target: str, eye: Pose, way) -> None:
    session = one_robot(target, way, eye, seconds=6.0)
    assert_sound(session, offline(session))


@pytest.mark.parametrize("target", ["charuco", "checkerboard"])
@pytest.mark.parametrize("faces", [1, 2])
def test_one_sighting_a_camera_gives_no_wrong_pose(target: str, faces: int) -> None:
    for seed in (1, 2, 3):
        session = make_session(lab_plan(target, seed=seed))
        session = with_pictures(session, 1, faces=faces)
        results = offline(session)
        assert_sound(session, results)
        if target == "checkerboard" and faces == 1:
            for camera in results.network.cameras.values():
                assert camera.status == "undetermined"
                assert "drive past it again" in camera.undetermined[0]


def test_frontal_faces_alone_give_no_wrong_pose() -> None:
    for seed in (1, 2, 3):
        session = one_robot("charuco", straight(speed=0.2), _AHEAD, seconds=8.0, seed=seed)
        session = with_pictures(session, 20, faces=1)
        assert_sound(session, offline(session))


def test_session_may_start_in_front_of_a_camera_and_see_a_camera_once_or_never() -> None:
    plan = lab_plan()
    away = CameraPlan(looking_at((9.0, 9.0, 1.5), (12.0, 12.0, 0.5)))
    session = make_session(replace(plan, cameras=plan.cameras | {"c4": away}))
    once = [m for n, m in session.messages if n == "c2" and isinstance(m, Sightings) and m.faces][3]
    messages = [
        (n, m)
        for n, m in session.messages
        if n != "c2" or not isinstance(m, Sightings) or m is once
    ]
    session = replace(session, messages=tuple(messages))
    results = offline(session)
    assert_sound(session, results)
    cameras = results.network.cameras
    assert [cameras[name].status for name in ("c1", "c2", "c3")] == ["located"] * 3
    assert cameras["c4"].status == "unseen"
    first, second = (cameras[name].position_sigma for name in ("c1", "c2"))
    assert first is not None
    assert second is not None
    assert second > first


def test_picture_that_comes_twice_counts_once(charuco: Session, charuco_results: Results) -> None:
    twice = [item for item in charuco.messages for _ in range(2 if _is_picture(item) else 1)]
    # The second time also much later, out of order.
    late = [item for item in charuco.messages if _is_picture(item)][::7]
    pipeline = pushed(charuco.inputs, (*twice, *late))
    again = pipeline.results()
    assert again.network.located == charuco_results.network.located
    np.testing.assert_array_equal(again.covariance, charuco_results.covariance)
    shown = sum(bool(m.faces) for _, m in charuco.messages if isinstance(m, Sightings))
    repeated = sum(bool(m.faces) for _, m in late if isinstance(m, Sightings))
    assert pipeline.left_out["repeated"] == shown + repeated


def _is_picture(item: tuple[str, Sent]) -> bool:
    return isinstance(item[1], Sightings)


# -- a second robot -------------------------------------------------------------------------------


def two(first: str, second: str, way=None, **changes) -> Session:
    """r1 drives around the lab; r2 elsewhere in it."""
    robots = {
        "r1": RobotPlan(circle(), target_of(first)),
        "r2": RobotPlan(way or circle(), structs.replace(target_of(second), name="other")),
    }
    start = Pose.planar(0.0, 2.4, np.pi)  # opposite on the circle, driving the same way around
    robots["r2"] = replace(robots["r2"], map_from_odom=start)
    return make_session(Plan(lab_cameras(), robots, **changes))


def late(session: Session, robot: str, seconds: float) -> Session:
    """The same, with a robot whose bridge starts later."""
    first_ns = EPOCH_NS + to_ns(seconds)
    kept = [
        (n, m)
        for n, m in session.messages
        if n != robot or not isinstance(m, Odometry) or m.stamp_ns >= first_ns
    ]
    return replace(session, messages=tuple(kept))


@pytest.mark.parametrize("seconds", [0.0, 9.0])
def test_second_robot_with_equal_faces_joins_the_map(seconds: float) -> None:
    session = late(two("charuco", "checkerboard", seconds=22.0), "r2", seconds)
    results = offline(session)
    assert_sound(session, results)
    assert results.network.located == ["c1", "c2", "c3"]
    assert all(camera.rejected == 0 for camera in results.network.cameras.values())
    stamps_ns, way = results.trajectories["r2"]
    for index in range(0, len(stamps_ns), 50):
        true = session.map_from_base("r2", int(stamps_ns[index]))
        assert np.abs(way[index].difference(true)).max() < 0.05


def test_camera_that_only_the_second_robot_meets_is_located() -> None:
    session = two("charuco", "checkerboard", seconds=22.0)
    name = session.inputs.targets["r1"].name
    kept: list[tuple[str, Sent]] = []
    for node, message in session.messages:
        if node == "c3" and isinstance(message, Sightings):
            faces = tuple(face for face in message.faces if face.target != name)
            kept.append((node, replace(message, faces=faces)))
        else:
            kept.append((node, message))
    session = replace(session, messages=tuple(kept))
    results = offline(session)
    assert_sound(session, results)
    assert results.network.located == ["c1", "c2", "c3"]


@pytest.mark.parametrize("way", [standing(), turning()], ids=["stands", "turns"])
def test_second_robot_with_equal_faces_on_the_spot_spoils_nothing(way) -> None:
    session = two("charuco", "checkerboard", way, seconds=12.0)
    results = offline(session)
    assert_sound(session, results)
    assert results.network.located == ["c1", "c2", "c3"]


# -- robots that look alike -----------------------------------------------------------------------


def alike(session: Session) -> Session:
    """The same, but all robots carry one target, so that no sighting says whose it is."""
    targets = dict.fromkeys(session.inputs.targets, session.inputs.targets["r1"])
    messages: list[tuple[str, Sent]] = []
    for node, message in session.messages:
        if isinstance(message, Sightings):
            faces = tuple(replace(face, target="") for face in message.faces)
            messages.append((node, replace(message, faces=faces)))
        else:
            messages.append((node, message))
    inputs = replace(session.inputs, targets=targets)
    return replace(session, messages=tuple(messages), inputs=inputs)


@pytest.mark.parametrize("target", ["charuco", "checkerboard"])
def test_robots_that_look_alike_are_told_apart_by_how_they_drive(target: str) -> None:
    session = alike(two(target, target, circle(speed=0.3), seconds=22.0))
    pipeline = pushed(session.inputs, session.messages)
    results = pipeline.results()
    assert_sound(session, results)
    assert results.network.located == ["c1", "c2", "c3"]
    shown = sum(bool(m.faces) for _, m in session.messages if isinstance(m, Sightings))
    assert pipeline.left_out.get("untold_robot", 0) < 0.2 * shown
    stamps_ns, way = results.trajectories["r2"]
    true = session.map_from_base("r2", int(stamps_ns[-1]))
    assert np.abs(way[len(way) - 1].difference(true)).max() < 0.05


def test_robots_that_look_and_drive_alike_are_left_out_by_name() -> None:
    session = alike(two("charuco", "charuco", circle(), seconds=12.0))
    pipeline = pushed(session.inputs, session.messages)
    results = pipeline.results()
    assert_sound(session, results)
    assert results.network.located == []
    assert pipeline.left_out["untold_robot"] > 0
    assert "give each robot its own target" in pipeline.last_problem


def test_first_sighting_at_the_first_and_only_odometry_reading() -> None:
    whole = make_session(lab_plan("charuco", seconds=5.0))
    seen = next(message for _, message in whole.messages if isinstance(message, Sightings))
    robot, first = next(item for item in whole.messages if isinstance(item[1], Odometry))
    camera = next(node for node, message in whole.messages if message is seen)
    at_once = replace(seen, stamp_ns=first.stamp_ns)
    session = replace(whole, messages=[(robot, first), (camera, at_once)])
    assert_sound(session, offline(session))
