"""Errors against the truth that a simulator leaves."""

import json
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
from support.fusion.networks import located

from trigpoint.base.errors import InputError
from trigpoint.geometry import Pose
from trigpoint.map.network import CameraRecord, Network, PoseRecord, Statistics
from trigpoint.tools.networks.truth import TruthFile, load_truth, network_error

TRUE = {
    "c1": Pose.planar(0.0, 0.0, 0.0),
    "c2": Pose.planar(3.0, 0.0, 1.0),
    "c3": Pose.planar(0.0, 4.0, -2.0),
}
TRUTH = TruthFile({name: PoseRecord.of(pose) for name, pose in TRUE.items()})
SIGMA = 0.02


def network_of(errors: dict[str, list[float] | None]) -> tuple[Network, np.ndarray]:
    """A network with these errors (None: not located), each unknown with a sigma of 2 cm."""
    cameras = {}
    for name, error in errors.items():
        if error is None:
            cameras[name] = CameraRecord("undetermined", ("everything",))
            continue
        pose = TRUE.get(name, Pose.identity()).disturbed(error)
        cameras[name] = located(pose, SIGMA**2 * np.eye(6))
    count = sum(error is not None for error in errors.values())
    network = Network("lab", str(uuid4()), "smoother", cameras, {}, Statistics(1.0, 3))
    return network, SIGMA**2 * np.eye(6 * count)


def test_errors_are_distances_angles_and_sigmas() -> None:
    error = network_error(*network_of({"c1": [0.03, 0.04, 0, 0, 0, 0.1], "c2": [0.0] * 6}), TRUTH)
    assert error.cameras["c1"].position == pytest.approx(0.05)
    assert error.cameras["c1"].rotation == pytest.approx(0.1)
    assert error.cameras["c1"].sigmas == pytest.approx(2.5)
    assert error.cameras["c2"].position == pytest.approx(0.0, abs=1e-12)
    squares = (0.03**2 + 0.04**2 + 0.1**2) / SIGMA**2
    assert error.nees == pytest.approx(squares / 12, rel=0.01)


def test_map_that_is_turned_as_a_whole_fits_a_covariance_that_knows_the_rest_well() -> None:
    """0.3 rad about the origin, where the cameras among each other are known to 0.1 mm."""
    turned = {name: Pose.planar(0.0, 0.0, 0.3) @ pose for name, pose in TRUE.items()}
    errors = {name: list(pose.difference(TRUE[name])) for name, pose in turned.items()}
    network, _ = network_of(dict(errors))
    by_turn = np.concatenate(
        [[-p.translation[1], p.translation[0], 0, 0, 0, 1.0] for p in turned.values()]
    )
    covariance = 0.3**2 * np.outer(by_turn, by_turn) + 1e-8 * np.eye(18)
    error = network_error(network, covariance, TRUTH)
    assert error.nees == pytest.approx(1 / 18, rel=0.01)


def test_distance_error_is_the_mean_over_all_pairs() -> None:
    # c1-c2 is 3 m and 0.1 m too long, c1-c3 is 4 m and as it was, c2-c3 is 5 m.
    error = network_error(
        *network_of({"c1": [0.0] * 6, "c2": [0.1, 0, 0, 0, 0, 0], "c3": [0.0] * 6}), TRUTH
    )
    expected = (0.1 + 0.0 + (np.hypot(3.1, 4.0) - 5.0)) / 3
    assert error.distance == pytest.approx(expected)


def test_camera_that_is_not_located_or_not_in_the_truth_is_left_out() -> None:
    network, covariance = network_of({"c1": None, "c2": [0.0] * 6, "x": [1.0] * 6, "c3": [0.0] * 6})
    error = network_error(network, covariance, TRUTH)
    assert error.cameras.keys() == {"c2", "c3"}
    assert error.nees == pytest.approx(0.0, abs=1e-12)
    assert error.distance == pytest.approx(0.0, abs=1e-12)


def test_one_camera_has_no_distance() -> None:
    error = network_error(*network_of({"c1": [0.0] * 6}), TRUTH)
    assert error.distance is None
    assert error.nees == pytest.approx(0.0, abs=1e-12)


def test_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    camera = {"translation": [1, 2, 3], "quaternion": [0, 0, 0, 1]}
    path.write_text(json.dumps({"cameras": {"c1": camera}, "robots": {"r1": "r1_truth.tum"}}))
    truth = load_truth(path)
    np.testing.assert_array_equal(truth.cameras["c1"].pose.translation, [1, 2, 3])
    assert truth.robots == {"r1": "r1_truth.tum"}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"cameras": {"c1": 3}}'])
def test_file_that_is_none_is_one_clear_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(InputError, match="no truth file") as caught:
        load_truth(path)
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"truth\.json: there is no such truth file"):
        load_truth(tmp_path / "truth.json")
