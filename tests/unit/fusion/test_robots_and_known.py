"""Several robots in one map, and cameras that are known from an earlier drive."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import (
    RobotPlan,
    Session,
    circle,
    lab_plan,
    make_session,
    offline,
    pushed,
)
from support.fusion.honesty import assert_honest

from trigpoint.contract.messages import Odometry, Sightings
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.inputs import load_known
from trigpoint.geometry import Pose
from trigpoint.tools.simulation.sight.targets import target_of


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


def test_target_of_a_robot_that_the_site_file_gives_another_is_left_out_by_name() -> None:
    session = two_robots(3.0)
    plain = session.inputs.targets
    inputs = replace(session.inputs, targets=dict.fromkeys(plain, plain["r1"]))
    pipeline = pushed(inputs, session.messages)
    assert pipeline.left_out["unknown_target"] > 0
    assert "a target «other» that no robots carry" in pipeline.last_problem


def test_where_the_robot_that_begins_the_map_is_never_seen_the_other_is_not_blamed() -> None:
    session = two_robots(6.0)
    ours = session.plan.robots["r1"].target.name
    seen = tuple(
        (n, replace(m, faces=tuple(f for f in m.faces if f.target != ours)))
        if isinstance(m, Sightings)
        else (n, m)
        for n, m in session.messages
    )
    pipeline = pushed(session.inputs, seen)
    pipeline.finish()
    cameras = pipeline.results().network.cameras
    (reason,) = next(c.undetermined for c in cameras.values() if c.status == "undetermined")
    assert "it begins where robot r1 does, and no camera saw that robot" in reason
    assert not [name for name, c in cameras.items() if c.status == "located"]


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
    found = pipeline._estimator.robot("r1")
    assert found is not None
    moment = found.stamp_ns
    assert moment >= stamp_ns
    error = found.map_from_base.difference(session.map_from_base("r1", moment))[[0, 1, 5]]
    inner = np.ix_([0, 1, 5], [0, 1, 5])
    assert np.sqrt(error @ np.linalg.solve(found.covariance[inner], error)) < 5
