"""What the extended Kalman filter believes: no more than its sightings say."""

from collections.abc import Iterator

import numpy as np
import pytest
from support.fusion.small_problems import EPOCH_NS, SECONDS, eyes, see, small_data, true_pose

from trigpoint.base.clock import to_ns
from trigpoint.fusion.estimators.filters.extended_kalman_filter import KalmanFilterState
from trigpoint.fusion.estimators.filters.filter_state import ReadSighting
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose

ROBOT, CAMERA = "r1", "c1"
# x and y of a decimetre and a heading of ten degrees, as after a long way.
DRIFTED = np.diag(np.square([0.1, 0.1, np.radians(10.0)]))


def read_sightings(
    data: DataSet, noise_px: float, *, every_s: float = 0.15
) -> Iterator[tuple[int, ReadSighting]]:
    """What the camera sees of the robot on its way."""
    random = np.random.default_rng(2)
    for seconds in np.arange(0.1, SECONDS - 0.1, every_s):
        stamp_ns = EPOCH_NS + to_ns(float(seconds))
        pose = true_pose(data, ROBOT, stamp_ns)
        yield (
            stamp_ns,
            ReadSighting(see(data, CAMERA, ROBOT, stamp_ns, noise_px, random), pose),
        )


def drifted(data: DataSet, start: Pose) -> KalmanFilterState:
    """A robot that is known no better than DRIFTED, its odometry's scales exactly; no camera."""
    track = data.tracks[ROBOT]
    nothing = KalmanFilterState({}, {}, {}, {}, {}, {}, np.zeros((0, 0)))
    ready = nothing.with_robot_priors(data, ROBOT, start, track.first_ns)
    return ready.with_part(("last", ROBOT), DRIFTED).only([("last", ROBOT)])


def followed(data: DataSet, start: Pose, noise_px: float = 0.3) -> KalmanFilterState:
    """After the robot drove past the camera, of which nothing was known."""
    filter_state, lens = drifted(data, start), data.lenses[CAMERA]
    for stamp_ns, sighting in read_sightings(data, noise_px):
        filter_state = filter_state.advanced(data, ROBOT, stamp_ns)
        if CAMERA in filter_state.cameras:
            taken = filter_state.updated(
                data, ReadSighting(sighting.observation, filter_state.poses[ROBOT])
            )
        else:
            taken = filter_state.with_camera(data, sighting, CameraState(eyes()[CAMERA], lens))
        assert taken is not None
        filter_state = taken[0]
    return filter_state


def robot_sigmas(filter_state: KalmanFilterState) -> np.ndarray:
    """Of the twist's x, y and heading."""
    part = filter_state.columns["last", ROBOT]
    return np.sqrt(np.diagonal(filter_state.covariance)[part])


@pytest.fixture(scope="module")
def data() -> DataSet:
    return small_data()


def test_a_camera_placed_by_a_drifted_robot_says_nothing_of_its_drift(data: DataSet) -> None:
    after = followed(data, Pose.identity())
    sigmas = robot_sigmas(after)
    # What is not known of the start moves robot and camera as one; a sighting can't see that.
    assert np.all(sigmas >= np.sqrt(np.diagonal(DRIFTED)) * (1 - 1e-6))
    assert np.all(sigmas < 1.2 * np.sqrt(np.diagonal(DRIFTED)))


def test_another_start_moves_everything_as_one_and_what_is_known_of_it(data: DataSet) -> None:
    here, there = Pose.identity(), Pose.planar(3.0, -2.0, 1.1)
    first, second = followed(data, here), followed(data, there)
    turned = there @ first.states[CAMERA].map_from_camera
    apart = second.states[CAMERA].map_from_camera.difference(turned)
    np.testing.assert_allclose(apart, 0.0, atol=1e-5)
    turned = there @ first.poses[ROBOT]
    np.testing.assert_allclose(second.poses[ROBOT].difference(turned), 0.0, atol=1e-5)
