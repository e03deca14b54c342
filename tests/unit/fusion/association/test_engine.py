"""The engine on small sessions: what it locates is what enumerating every explanation leaves."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import (
    Plan,
    RobotPlan,
    circle,
    lab_cameras,
    make_session,
    observed,
    pushed,
)
from support.oracle.agreement import disagreements
from support.oracle.sessions import Shape, SmallSession, data_of, small_session

from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.modes import ModeFinder
from trigpoint.fusion.association.visits import visits_of
from trigpoint.fusion.estimators.smoother.batch import BatchSolution
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.pipeline import Inputs
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.site.config import PriorConfig
from trigpoint.tools.simulation.sight.targets import target_of


def network_of(session: SmallSession) -> Network:
    inputs = Inputs(session.site, {"r1": session.target})
    return pushed(inputs, tuple(session.messages)).results().network


@pytest.mark.parametrize(
    "shape",
    [
        Shape(1, (0, 0), is_alike=False),
        Shape(2, (0, 0), is_alike=True),
        Shape(8, (0, 1, 0), is_alike=False, is_near=True),
        Shape(6, (0, 0, 0), is_alike=False, displaced=(1,)),
        Shape(7, (0, 0, 0), is_alike=False, move=2),
    ],
    ids=lambda shape: f"{shape.seed}",
)
def test_engine_agrees_with_enumeration(shape: Shape) -> None:
    session = small_session(shape)
    found = disagreements(session.oracle().verdicts(), network_of(session).cameras)
    assert not [line for line in found if "among the alternatives" not in line]


def test_places_left_open_are_named_and_share_the_posterior() -> None:
    camera = network_of(small_session(Shape(3, (0,), is_alike=True))).cameras["c1"]
    assert camera.status == "undetermined"
    assert len(camera.alternatives) > 1
    assert sum(place.probability for place in camera.alternatives) == pytest.approx(1.0, abs=1e-4)
    places = np.array([place.map_from_camera.translation for place in camera.alternatives])
    assert np.linalg.norm(places - places[0], axis=1).max() > 0.5
    assert camera.map_from_camera is None


def test_camera_of_one_picture_says_on_how_much_it_rests() -> None:
    network = network_of(small_session(Shape(5, (0, 0), is_alike=False)))
    assert network.cameras["c1"].confirmed


def test_where_nothing_is_ever_moved_sightings_from_a_new_place_are_wrong() -> None:
    session = small_session(Shape(7, (0, 0, 0), is_alike=False, move=2))
    assert network_of(session).cameras["c1"].status == "undetermined"
    never = PriorConfig(disturbed=1e-200, event=1e-100)
    fusion = structs.replace(session.site.fusion, priors=never)
    site = structs.replace(session.site, fusion=fusion)
    camera = network_of(replace(session, site=site)).cameras["c1"]
    assert camera.status == "located"
    assert camera.rejected == 2


def test_camera_a_long_way_off_is_located_as_well_as_odometry_says() -> None:
    """What is known to metres is known: only behind a break is nothing of a place known."""
    session = small_session(Shape(5, (0, 1), is_alike=False))
    robot = session.site.robots["r1"]
    rough = structs.replace(robot, odometry=structs.replace(robot.odometry, distance=2.0))
    site = structs.replace(session.site, robots={"r1": rough})
    camera = network_of(replace(session, site=site)).cameras["c2"]
    assert camera.status == "located"
    assert camera.covariance is not None
    assert 2.0 < np.sqrt(np.trace(np.reshape(camera.covariance, (6, 6))[:3, :3])) < 20.0


def test_explanation_of_nothing_wrong_has_no_events() -> None:
    data, observations = data_of(Shape(0, (0, 1, 0), is_alike=False))
    found = explain(data, observations)
    assert not found.lifts
    assert not found.moves


def test_lens_to_solve_from_is_what_all_visits_say_together() -> None:
    """One visit's, up to a fifth off, left a session of ten cameras unsolved in 279 iterations."""
    cameras = lab_cameras(2, more='intrinsics = "estimate"\ntime_offset_sigma = 0.05')
    robots = {"r1": RobotPlan(circle(speed=0.15), target_of("charuco"))}
    data = observed(make_session(Plan(cameras, robots, seconds=160.0, picture_rate=1.0, seed=2)))
    seen = [entry.observation for entry in data.entries]
    found, batch = explain(data, seen), BatchSolution(data)
    batch.solve(found)
    finder, problem, solution = ModeFinder(data, seen, Events()), batch.problem, batch.solution
    assert problem is not None
    assert solution is not None
    sigmas = np.sqrt(np.diagonal(solution.reduced.covariance()))

    def off(name: str, parameters: Array) -> float:
        """How many sigmas a camera's lens is from the solution's."""
        apart = parameters - batch.state.cameras[name].lens.parameters
        return float(np.linalg.norm(apart / sigmas[problem.layout.lens[name]]))

    for name in cameras:
        visits = [finder.modes_of(v) for v in visits_of(data, seen) if v.camera == name]
        single = [off(name, visit.modes[0].camera.lens.parameters) for visit in visits]
        assert len(single) > 2
        assert off(name, found.places[name, 0].lens.parameters) < min(single)


def test_known_camera_that_nothing_ties_has_the_clock_of_its_visit() -> None:
    """It hangs elsewhere since, and one visit shows where: what the site file says of its clock
    alone, none, dated the move 0.12 s late."""
    cameras = lab_cameras(3, more='intrinsics = "estimate"\ntime_offset_sigma = 0.2')
    poses = {name: camera.map_from_camera for name, camera in cameras.items()}
    turn = so3.exp(np.array([0.05, 0.04, 0.1]))
    away = Pose(turn @ poses["c1"].rotation, poses["c1"].translation + np.array([0.3, -0.2, 0.15]))
    cameras = {name: replace(camera, time_offset_s=0.12) for name, camera in cameras.items()}
    cameras["c1"] = replace(cameras["c1"], map_from_camera=away)
    robots = {"r1": RobotPlan(circle(), target_of("charuco"))}
    session = make_session(Plan(cameras, robots, seconds=12.0, picture_rate=2.0, seed=1))
    known = KnownCameras(poses, 1e8 * np.eye(18))
    data = observed(replace(session, inputs=replace(session.inputs, known=known)))
    found = explain(data, [entry.observation for entry in data.entries])
    assert found.places["c1", 1].time_offset_s == pytest.approx(0.12, abs=0.02)
