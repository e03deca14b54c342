import itertools

import numpy as np
import pytest
from support.builders_demo import (
    make_camera,
    make_key,
    make_results,
    make_robot,
    make_track,
    make_unlocated,
)

from trigpoint.tools.report.demo.results import Track


def test_run_in_which_all_went_well_has_no_failure():
    assert make_results().failures == []


def test_camera_that_the_robot_met_and_that_is_not_located_is_a_failure():
    missed = make_unlocated("c9", came_by=True, status="undetermined")
    (failure,) = make_results(cameras=(make_camera("c1"), missed)).failures
    assert "c9" in failure
    assert "undetermined" in failure


def test_camera_that_the_robot_did_not_meet_is_no_failure():
    results = make_results(cameras=(make_camera("c1"), make_unlocated("c9", came_by=False)))
    assert results.failures == []
    assert [camera.name for camera in results.expected] == ["c1"]


def test_camera_further_off_than_five_sigmas_is_a_failure():
    far = make_camera("c1", error=(0.051, 0.0, 0.0), sigma=0.01)
    near = make_camera("c2", error=(0.049, 0.0, 0.0), sigma=0.01)
    (failure,) = make_results(cameras=(far, near)).failures
    assert "c1 is 5.1 of its sigmas" in failure


@pytest.mark.parametrize(
    "count",
    [
        make_key(recorded=99),
        make_key(received={"fusion/fusion": 99}),
        make_key(sent=101),
        make_key(sent=None),
    ],
)
def test_message_lost_on_a_reliable_key_is_a_failure(count):
    (failure,) = make_results(keys=(count,)).failures
    assert "camera/c1/sightings" in failure


def test_message_lost_on_a_best_effort_key_is_no_failure():
    assert make_results(keys=(make_key(is_reliable=False, recorded=1),)).failures == []


def test_counts_that_a_restart_broke_are_no_failure():
    keys = (make_key(recorded=99),)
    assert make_results(keys=keys, restarts={"edge c1": 1}).failures == []


def test_message_that_a_node_rejects_is_a_failure():
    (failure,) = make_results(rejected={"fusion/fusion": 1}).failures
    assert "fusion/fusion rejected 1" in failure


def test_promised_distance_error_is_what_errors_drawn_from_the_covariance_come_to():
    random = np.random.default_rng(5)
    places = [(0.0, 1.0, 1.5), (8.0, -1.0, 1.0), (3.0, 4.0, 2.0)]
    cameras = tuple(
        make_camera(f"c{i}", place, error=(0.0, 0.0, 0.0)) for i, place in enumerate(places)
    )
    root = 1e-3 * random.normal(size=(18, 18))
    results = make_results(cameras=cameras, covariance=root @ root.T)
    drawn = (random.normal(size=(4000, 18)) @ root.T).reshape(-1, 3, 6)[..., :3]
    off = []
    for i, j in itertools.combinations(range(3), 2):
        true = np.subtract(places[j], places[i])
        apart = np.linalg.norm(true + drawn[:, j] - drawn[:, i], axis=1)
        off.append(np.abs(apart - np.linalg.norm(true)).mean())
    assert results.distances.expected_error_m == pytest.approx(np.mean(off), rel=0.05)


def test_no_distance_error_is_promised_of_one_camera():
    assert make_results(cameras=(make_camera("c1"),)).distances.expected_error_m is None


def test_final_error_is_against_the_truth_at_the_same_moment():
    early = make_track(0.02).until(4.0)
    error = make_robot(live=early).final_error(early)
    assert error is not None
    assert error.place_m == pytest.approx(0.02)


def test_final_heading_error_is_the_short_way_round():
    robot = make_robot(truth=make_track(heading=3.1))
    error = robot.final_error(make_track(heading=-3.1))
    assert error is not None
    assert error.heading_rad == pytest.approx(2 * np.pi - 6.2)


def test_track_without_rows_has_no_final_error():
    empty = Track(np.zeros(0), np.zeros((0, 2)), np.zeros(0))
    assert make_robot().final_error(empty) is None
