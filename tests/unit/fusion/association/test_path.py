"""How a robot moved between visits, by what other visits show of it."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    Plan,
    RobotPlan,
    Session,
    circle,
    lab_cameras,
    make_session,
    observed,
)

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.graph import Graph
from trigpoint.fusion.association.modes import ModeFinder
from trigpoint.fusion.association.visits import visits_of
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.tools.simulation.sight.targets import target_of


def graph_of(session: Session) -> Graph:
    data = observed(session)
    seen = [entry.observation for entry in data.entries]
    finder = ModeFinder(data, seen, Events())
    return Graph(data, [finder.modes_of(visit) for visit in visits_of(data, seen)], Events())


@pytest.fixture(scope="module")
def graph() -> Graph:
    """c1 sees the robot from 0 to 23 s, c2 from 10 to 54 s, c3 from 40 s."""
    robot = RobotPlan(circle(speed=0.08), target_of("charuco"))
    return graph_of(make_session(Plan(lab_cameras(3), {"r1": robot}, 60.0, picture_rate=0.7)))


def test_visit_that_goes_on_shows_more_of_the_way_than_odometry(graph: Graph) -> None:
    path = graph.paths["r1"]
    free = np.ix_(path.tangent, path.tangent)
    seen = graph.seen("r1", frozenset())
    step, one = max(seen.items(), key=lambda item: path.log_covariance[item[0]])
    assert one.log_covariance < path.log_covariance[step] - 3
    driven = path.steps(np.zeros(2)).motion[step]
    apart = one.motion.difference(driven)[path.tangent]
    spread = np.linalg.inv(path.information[step][free]) + np.linalg.inv(one.information[free])
    assert apart @ np.linalg.solve(spread, apart) < 20


def test_visit_that_is_wrong_shows_nothing_of_the_way(graph: Graph) -> None:
    seen = graph.seen("r1", frozenset())
    step, one = next(iter(seen.items()))
    without = graph.seen("r1", frozenset({one.number}))
    assert step not in without or without[step].number != one.number


def test_where_odometry_broke_it_has_no_word(graph: Graph) -> None:
    """What c1 shows of its own beside odometry is less than with it."""
    both = graph.seen("r1", frozenset())
    gap = next(step for step in both if graph.across(("r1", step)) is not None)
    alone = graph.across(("r1", gap))
    assert alone is not None
    assert alone.surprise < 20 + graph.paths["r1"].log_covariance[gap]
    assert graph.across(("r1", gap), frozenset(range(len(graph.visits)))) is None


def test_camera_is_seen_from_where_the_robot_is_as_its_clock_says() -> None:
    """A clock that is late by 50 ms shows the robot where it was 20 mm and 17 mrad before, which it
    tells where the robot stops on its way."""

    def halting(seconds: Array) -> Pose:
        return circle(hold_s=0.0)(seconds - np.clip(seconds - 1.5, 0.0, 1.0))

    cameras = {
        name: replace(plan, time_offset_s=0.05, more="time_offset_sigma = 0.05")
        for name, plan in lab_cameras(1).items()
    }
    robot = RobotPlan(halting, target_of("charuco"))
    session = make_session(Plan(cameras, {"r1": robot}, 5.0, picture_rate=5.0))
    graph = graph_of(session)
    (found,) = graph.visits
    there = session.map_from_base("r1", found.visit.stamp_ns)
    seen, information = graph.modes[0].base_from_camera, graph.modes[0].information
    error = (there.inverse() @ cameras["c1"].map_from_camera).difference(seen[0])
    covariance = np.linalg.inv(information[0])[:6, :6]
    assert error @ np.linalg.solve(covariance, error) < 30
    assert np.linalg.norm(error[:3]) < 0.01
