"""The Cramér-Rao bound of a session, against the estimator's own covariance."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Session, make_session, offline, write_session

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import InputError
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.estimators.results import Results
from trigpoint.geometry import Pose
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.networks.bound import session_bound
from trigpoint.tools.networks.cramer_rao import Bound
from trigpoint.tools.sessions.inputs import session_inputs
from trigpoint.tools.simulation.motion.odometry import poses_at


@pytest.fixture(scope="module")
def bound(recorded: Path) -> Bound:
    return bound_of(recorded)


def bound_of(folder: Path) -> Bound:
    recording = open_recording(folder)
    return session_bound(recording, session_inputs(recording, site=None, network=None), folder)


@pytest.fixture(scope="module")
def results(drive: Session) -> Results:
    return offline(drive)


def test_estimators_sigmas_are_just_above_the_bound(results: Results, bound: Bound) -> None:
    assert bound.cameras == results.network.located
    for index, name in enumerate(bound.cameras):
        rows = slice(6 * index, 6 * index + 3)
        least = np.sqrt(np.trace(bound.covariance[rows, rows]))
        found = results.network.cameras[name].position_sigma
        # It allows the robot a little slip and is linearised at its own estimate: a few percent.
        assert 0.97 * least < found < 1.15 * least


def test_bound_of_the_distances_is_of_the_size_of_their_error(
    drive: Session, results: Results, bound: Bound
) -> None:
    error = drive.error(results).distance
    assert error is not None
    # Three distances: their mean error is within a factor of four of what is expected of it in all
    # but a few drives of a thousand.
    assert bound.mean_distance_error / 4 < error < 4 * bound.mean_distance_error


def test_distance_error_of_known_sigmas() -> None:
    covariance = np.zeros((12, 12))
    covariance[0, 0] = covariance[6, 6] = 0.01**2  # along the line between the two
    covariance[1, 1] = 1.0  # across it
    places = np.array([[0.0, 0, 0], [2.0, 0, 0]])
    bound = Bound(["a", "b"], covariance, places)
    assert bound.mean_distance_error == pytest.approx(0.01 * np.sqrt(2) * np.sqrt(2 / np.pi))
    assert Bound(["a"], covariance[:6, :6], places[:1]).mean_distance_error == 0.0


def test_more_pictures_lower_the_bound(drive: Session, bound: Bound, tmp_path: Path) -> None:
    more = make_session(replace(drive.plan, picture_rate=2.0))
    lower = bound_of(write_session(more, tmp_path / "more"))
    assert np.all(np.diagonal(lower.covariance) < np.diagonal(bound.covariance))


def test_session_without_truth_or_without_sightings_is_one_clear_line(
    drive: Session, tmp_path: Path
) -> None:
    folder = write_session(drive, tmp_path / "a")
    (folder / "r1_truth.tum").unlink()
    with pytest.raises(InputError, match=r"r1_truth\.tum: cannot be read"):
        bound_of(folder)
    (folder / "truth.json").unlink()
    with pytest.raises(InputError, match="there is no such truth file"):
        bound_of(folder)
    odometry = tuple((n, m) for n, m in drive.messages if isinstance(m, Odometry))
    with pytest.raises(InputError, match="no sighting whose truth is known"):
        bound_of(write_session(replace(drive, messages=odometry), tmp_path / "b"))


def test_poses_between_rows_are_the_same_share_of_the_step() -> None:
    stamps_ns = EPOCH_NS + to_ns(0.1) * np.arange(3)
    poses = Pose.planar([0.0, 1.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.4, 0.4])
    moments = EPOCH_NS + to_ns(0.01) * np.array([-5, 0, 5, 10, 15, 20, 99])
    found = poses_at(stamps_ns, poses, moments)
    np.testing.assert_allclose(found.translation[:, 0], [0, 0, 0.5, 1, 1, 1, 1])
    np.testing.assert_allclose(found.translation[:, 1], [0, 0, 0, 0, 1, 2, 2])
    np.testing.assert_allclose(found.heading, [0, 0, 0.2, 0.4, 0.4, 0.4, 0.4])
