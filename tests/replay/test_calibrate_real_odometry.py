"""`calibrate` over ten minutes of a real robot's odometry, from nothing, against its truth."""

from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from support.builders import REAL_DATA

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.sightings import by_itself
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.fusion.solver.levenberg_marquardt import solve_consistently
from trigpoint.geometry import Pose
from trigpoint.map.network import encode_network
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.calibrate.work import worked_out
from trigpoint.tools.networks.truth import TruthFile, load_truth, network_error
from trigpoint.tools.sessions.inputs import session_inputs

FOLDER = REAL_DATA / "real-odometry"
# Of corners about the board that fits them best, over what they were drawn with.
MOST_SCATTER = 4.0
ROBOTS = (
    "robot1",
    *(pytest.param(f"robot{number}", marks=pytest.mark.long) for number in (2, 3, 4, 5)),
)

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"the real sessions are not at {FOLDER}"
)


@cache  # each robot has one test: solved once, whichever process of a parallel run takes it
def solved(robot: str) -> Pipeline:
    recording = open_recording(FOLDER / robot)
    return worked_out(recording, session_inputs(recording, site=None, network=None))


def truth_of(robot: str) -> TruthFile:
    return load_truth(FOLDER / robot / "truth.json")


def smoother_of(pipeline: Pipeline) -> Any:
    """The batch solution behind a pipeline that has finished."""
    return pipeline._estimator._batch  # pyright: ignore[reportAttributeAccessIssue, reportPrivateUsage]


@pytest.mark.parametrize("robot", ROBOTS)
def test_real_odometry_is_worked_out_as_well_as_can_be(robot: str) -> None:
    assert_errors_fit_the_joint_covariance(robot)
    assert_no_solution_from_the_truth_costs_less(robot)
    if robot in BY_THE_TABLE:
        assert_distances_are_as_good_as_by_a_start_at_the_truth(robot, *BY_THE_TABLE[robot])


def assert_errors_fit_the_joint_covariance(robot: str) -> None:
    results = solved(robot).results()
    located = results.network.located
    truth = truth_of(robot)
    assert len(located) == len(results.network.cameras) == len(truth.cameras)
    error = network_error(results.network, results.covariance, truth)
    assert error.nees is not None
    assert 0.3 <= error.nees <= 2.0
    for name, camera in error.cameras.items():
        assert camera.sigmas < 5, name
        record = results.network.cameras[name]
        # Of few sightings, one picture of two faces at which the robot slipped.
        assert rejected_boards(robot, name) <= max(2, 0.02 * record.sightings)
        assert record.reprojection_rms == pytest.approx(0.25, rel=0.1)  # as it was simulated
    assert msgspec.json.decode(encode_network(results.network))["map_id"]


def rejected_boards(robot: str, camera: str) -> int:
    """How many sightings that a lens can show are not used. Some were drawn 60 to 68° off the axis,
    where the polynomial has folded back into the picture: no board looks so."""
    data = smoother_of(solved(robot)).data
    count = 0
    for entry in data.of_camera(camera):
        observation = entry.observation
        target, lens = data.targets[observation.robot], data.lenses[camera]
        used = observation.verdict is Verdict.ACCEPTED
        for order, view in enumerate(observation.views):
            if used and not (observation.outliers and np.all(observation.outliers[order])):
                continue
            count += by_itself(view, lens, target, Events()).scatter < MOST_SCATTER
    return count


# What a batch solver found that was started at the truth, by the data's own table; robot 3's 24 mm
# were found with sightings that no lens can show (above), and are 47 mm without them.
BY_THE_TABLE = {"robot2": (0.122, 0.944), "robot3": (0.047, 0.896)}  # distance in m, heading scale


def assert_distances_are_as_good_as_by_a_start_at_the_truth(
    robot: str, distance_m: float, heading_scale: float
) -> None:
    results = solved(robot).results()
    # True over reported turns differ by as much between pieces of 2, 10 and 30 s of one session.
    # The distance scale is not held to the table's: a metre is worth 1.01 to 1.04 m on straight
    # stretches and 0.77 to 0.86 m in turns; which mean of both is found depends on how the noise
    # weighs them, which is learnt here and stated there. What a scale is for is held: distances.
    found = results.network.robots["r1"].heading_scale
    assert found == pytest.approx(heading_scale, abs=0.05)
    error = network_error(results.network, results.covariance, truth_of(robot))
    assert error.distance is not None
    assert error.distance < 1.2 * distance_m


def assert_no_solution_from_the_truth_costs_less(robot: str) -> None:
    batch = smoother_of(solved(robot))
    data: DataSet = batch.data
    used = data.usable(batch.state.cameras)
    here = solve_consistently(data, batch.state, tolerance=1e-4)
    true = at_truth(data, used, batch.state, truth_of(robot))
    there = solve_consistently(data, true, tolerance=1e-4)
    assert here is not None
    assert there is not None
    assert here.solution.cost <= there.solution.cost + 0.1


def at_truth(data: DataSet, used: list[int], state: State, truth: TruthFile) -> State:
    """The cameras where they truly are, and the robot where their pictures then put it."""
    cameras = {
        name: replace(camera, map_from_camera=truth.cameras[name].pose)
        for name, camera in state.cameras.items()
    }
    for index in used:
        entry = data.entries[index]
        assert entry.map_from_base is not None
        seen_by = state.cameras[entry.observation.camera].map_from_camera
        true = cameras[entry.observation.camera].map_from_camera
        base = true @ seen_by.inverse() @ entry.map_from_base
        heading = np.arctan2(base.rotation[1, 0], base.rotation[0, 0])
        x, y, _ = base.translation
        entry.map_from_base = Pose.planar(x, y, heading)
    return State(cameras, state.robots)
