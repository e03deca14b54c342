"""`calibrate` by each recursive filter, over a recorded session, as a user runs it."""

from pathlib import Path

import numpy as np
import pytest
from support.commands import Cli
from support.fusion.drives import lab_plan, make_session, write_session

from benchmarks.compositions.files import write_composition
from benchmarks.compositions.session import composed_session
from trigpoint.cli import run
from trigpoint.map.network import load_network
from trigpoint.tools.networks.truth import load_truth, network_error


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_session(
        make_session(lab_plan(picture_rate=0.6)), tmp_path_factory.mktemp("session")
    )


@pytest.mark.parametrize("estimator", ["ekf", "particle"])
def test_network_covariance_and_way_are_written(
    session: Path, tmp_path: Path, cli: Cli, estimator: str
) -> None:
    arguments = ["calibrate", str(session), "--estimator", estimator, "--out", str(tmp_path)]
    assert "errors against the joint covariance" in cli(*arguments).out
    network = load_network(tmp_path / "network.json")
    assert network.estimator == estimator
    assert network.located == ["c1", "c2", "c3"]
    with np.load(tmp_path / "covariance.npz") as archive:
        joint = archive["covariance"]
    assert joint.shape == (18, 18)
    error = network_error(network, joint, load_truth(session / "truth.json"))
    assert max(camera.sigmas for camera in error.cameras.values()) < 4
    assert (tmp_path / "r1.tum").read_text().count("\n") == 441


@pytest.fixture(scope="module")
def swaying(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A loop with a target that sways by a millimetre, of which the site file says nothing."""
    return write_composition(composed_session("mismatch", 7), tmp_path_factory.mktemp("swaying"))


@pytest.mark.parametrize("estimator", ["ekf", "particle"])
def test_what_the_session_tells_of_its_noise_holds_for_the_filters_too(
    swaying: Path, tmp_path: Path, estimator: str
) -> None:
    assert run(["calibrate", str(swaying), "--estimator", estimator, "--out", str(tmp_path)]) == 0
    network = load_network(tmp_path / "network.json")
    with np.load(tmp_path / "covariance.npz") as archive:
        error = network_error(network, archive["covariance"], load_truth(swaying / "truth.json"))
    # Of the two faces that c7 saw at once one is wrong, and nothing tells which.
    assert network.located == [f"c{number}" for number in range(1, 7)]
    assert max(camera.sigmas for camera in error.cameras.values()) < 4
    assert error.nees is not None
    assert error.nees < 2


def test_what_a_filter_does_not_work_out_is_one_line(tmp_path: Path, cli: Cli) -> None:
    folder = write_session(
        make_session(lab_plan(seconds=2.0, more="[fusion]\ntarget_rotation = 0.01")), tmp_path
    )
    text = cli.refused("calibrate", folder, "--estimator", "ekf").strip()
    assert "the estimator «ekf» does not estimate the faces' places" in text
    assert len(text.splitlines()) == 1
