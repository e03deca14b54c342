"""`calibrate` over ten minutes of a real robot's odometry, from nothing, against its truth."""

import msgspec
import pytest
from builders import REAL_DATA

from trigpoint.fusion.results import Results
from trigpoint.network import encode_network
from trigpoint.recorder.recording import open_recording
from trigpoint.tools.calibrate import calibrated
from trigpoint.tools.session_inputs import session_inputs
from trigpoint.tools.truth import NetworkError, load_truth, network_error

FOLDER = REAL_DATA / "real-odometry"

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"the real sessions are not at {FOLDER}"
)


def solved(robot: str) -> tuple[Results, NetworkError]:
    recording = open_recording(FOLDER / robot)
    results = calibrated(recording, session_inputs(recording, site=None, network=None))
    truth = load_truth(FOLDER / robot / "truth.json")
    return results, network_error(results.network, results.covariance, truth)


# What a batch solver reached that was started at the truth, by the data's own table.
@pytest.mark.parametrize(
    ("robot", "cameras", "distance_m", "distance_scale", "heading_scale"),
    [("robot2", 5, 0.122, 0.925, 0.944), ("robot3", 3, 0.024, 0.947, 0.896)],
)
def test_every_camera_is_located_as_well_as_by_a_start_at_the_truth(
    robot: str, cameras: int, distance_m: float, distance_scale: float, heading_scale: float
) -> None:
    results, error = solved(robot)
    located = results.network.located
    assert len(located) == cameras == len(results.network.cameras)
    assert error.distance is not None
    # The same data and the same model: the same solution but for details of the noise.
    assert error.distance < 1.5 * distance_m
    for name, camera in error.cameras.items():
        assert camera.sigmas < 5, name
        record = results.network.cameras[name]
        assert record.rejected <= 0.02 * record.sightings
        assert record.reprojection_rms == pytest.approx(0.25, rel=0.1)  # as it was simulated
    found = results.network.robots["r1"]
    assert found.distance_scale == pytest.approx(distance_scale, abs=0.02)
    # True over reported turns differ by as much between pieces of 2, 10 and 30 s of one session.
    assert found.heading_scale == pytest.approx(heading_scale, abs=0.05)
    assert msgspec.json.decode(encode_network(results.network))["map_id"]
