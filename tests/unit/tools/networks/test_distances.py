"""The command `distances`, as a user runs it, and its figures."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.commands import Cli
from support.fusion.networks import located

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import CameraRecord, Network, Statistics, save_network
from trigpoint.tools.networks.distances import Measured, compare, distances

PLACES = {
    "hall": [0.0, 0.0, 2.0],
    "door": [3.0, 0.0, 2.0],
    "yard": [3.0, 4.0, 2.0],
    "attic": [1.0, 1.0, 5.0],
}


def joint() -> Array:
    """A covariance with correlations between the cameras."""
    root = 1e-2 * np.random.default_rng(4).standard_normal((24, 24))
    return root @ root.T


def make_network(places: dict[str, list[float]] = PLACES) -> Network:
    cameras = {
        name: located(Pose(np.eye(3), np.array(place)), joint(), index)
        for index, (name, place) in enumerate(places.items())
    }
    cameras["cellar"] = CameraRecord("undetermined", undetermined=("height",))
    return Network("lab", "uuid", "smoother", cameras, {}, Statistics(1.0, 3))


@pytest.fixture
def network(tmp_path: Path) -> Path:
    save_network(tmp_path / "out", make_network(), covariance=joint(), trajectories={})
    return tmp_path / "out"


def test_distance_and_its_sigma_are_those_of_the_joint_covariance() -> None:
    found = distances(make_network(), joint(), [("hall", "yard"), ("yard", "attic")])
    np.testing.assert_allclose(found.metres, [5.0, np.sqrt(22.0)])
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(24), joint() * 1e-4, 40_000)
    moved = draws.reshape(-1, 4, 6)[:, :, :3] + np.array(list(PLACES.values()))
    sampled = np.linalg.norm(moved[:, [0, 2]] - moved[:, [2, 3]], axis=2)
    np.testing.assert_allclose(np.cov(sampled.T) * 1e4, found.covariance, rtol=0.05)


def test_what_all_cameras_are_off_together_does_not_count() -> None:
    shift = np.tile(np.eye(6), (4, 1))
    found = distances(make_network(), joint() + shift @ shift.T, [("hall", "door")])
    assert found.sigmas_m == pytest.approx(
        distances(make_network(), joint(), [("hall", "door")]).sigmas_m
    )


def test_comparison_adds_the_tapes_own_uncertainty() -> None:
    rows = [Measured("hall", "door", 3.1, 0.02), Measured("door", "yard", 3.9, 0.05)]
    found = compare(make_network(), joint(), rows)
    np.testing.assert_allclose(found.difference_m, [-0.1, 0.1])
    expected = np.hypot(found.network.sigmas_m, [0.02, 0.05])
    np.testing.assert_allclose(found.sigmas_m, expected)
    assert found.mean_error_m == pytest.approx(0.1)
    assert found.covariance[0, 1] == pytest.approx(found.network.covariance[0, 1])
    weighed = found.difference_m @ np.linalg.inv(found.covariance) @ found.difference_m / 2
    assert found.chi2_per_distance == pytest.approx(weighed)


def test_all_distances_are_shown_without_a_file(network: Path, cli: Cli) -> None:
    lines = cli("distances", network).out.splitlines()
    assert len(lines) == 1 + 6
    assert lines[2].split()[:3] == ["hall", "yard", "5.0000"]


def test_table_shows_every_measured_distance_and_the_mean_error(
    network: Path, tmp_path: Path, cli: Cli
) -> None:
    path = tmp_path / "tape.csv"
    path.write_text(
        "\ufeffcamera,camera,metres\n# with a steel tape\nhall, door,3.1\n\nyard,door,3.9,0.05\n"
    )
    lines = cli("distances", network / "network.json", "--measured", path).out.splitlines()
    assert [line.split()[:5] for line in lines[1:3]] == [
        ["hall", "door", "3.1000", "3.0000", "-10.00"],
        ["yard", "door", "3.9000", "4.0000", "+10.00"],
    ]
    assert lines[3].startswith("mean error of 2 distances: 10.00 cm")


def test_json_holds_the_same_in_metres(network: Path, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "tape.csv"
    path.write_text("hall,door,3.1,0.02\n")
    found = json.loads(cli("distances", network, "--measured", path, "--json").out)
    row = found["distances"][0]
    assert (row["from"], row["to"], row["measured_sigma"]) == ("hall", "door", 0.02)
    assert row["difference"] == pytest.approx(-0.1)
    assert row["sigma"] == pytest.approx(np.hypot(row["network_sigma"], 0.02))
    assert found["mean_error"] == pytest.approx(0.1)


def test_tapes_sigma_can_be_given_for_all_rows(network: Path, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "tape.csv"
    path.write_text("hall,door,3.1\nhall,yard,5,0.3\n")
    arguments = ["--measured", str(path), "--tape-sigma", "0.04", "--json"]
    rows = json.loads(cli("distances", network, *arguments).out)["distances"]
    assert [row["measured_sigma"] for row in rows] == [0.04, 0.3]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hal,door,3\n", ":1: the network has no camera «hal»; did you mean «hall»?"),
        ("hall,door,3\nhall,cellar,3\n", ":2: camera cellar is undetermined and has no place"),
        ("hall,door,three\n", ":1: the distance «three» is not a number"),
        ("hall,door,nan\n", ":1: the distance «nan» must be above 0"),
        ("hall,door,-3\n", ":1: the distance «-3» must be above 0"),
        ("hall,door,3,x\n", ":1: the sigma «x» is not a number"),
        ("hall,door,3,412\n", ":1: a sigma of 412 m; write decimals with a point"),
        ("hall;door;3,4\n", ":1: a row has camera,camera,metres"),
        ("hall,door\n", ":1: a row has camera,camera,metres"),
        ("hall,hall,3\n", ":1: the distance of camera hall from itself"),
        ("", ": no distance is in it; write rows of camera,camera,metres"),
        ("camera,camera,metres\n", ": no distance is in it"),
    ],
)
def test_wrong_row_is_named_with_file_and_line(
    network: Path, tmp_path: Path, cli: Cli, text: str, said: str
) -> None:
    path = tmp_path / "tape.csv"
    path.write_text(text)
    line = cli.refused("distances", network, "--measured", path)
    assert f"{path}{said}" in line


def test_missing_files_are_named(network: Path, tmp_path: Path, cli: Cli) -> None:
    assert "no such file of distances" in cli.refused(
        "distances", network, "--measured", tmp_path / "no"
    )
    assert "no such network file" in cli.refused("distances", tmp_path / "no.json")
    (network / "covariance.npz").unlink()
    assert "keep covariance.npz beside network.json" in cli.refused("distances", network)


def test_file_that_is_not_text_is_refused(network: Path, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "tape.ods"
    path.write_bytes(b"PK\x03\x04\xff\xfe\x00")
    assert "this is not text" in cli.refused("distances", network, "--measured", path)


def test_covariance_of_another_network_is_refused(network: Path, cli: Cli) -> None:
    np.savez(network / "covariance.npz", cameras=np.array(["hall"]), covariance=np.eye(6))
    assert "belongs to another network" in cli.refused("distances", network)


@pytest.mark.parametrize("sigma", ["0", "-1", "5", "nan"])
def test_impossible_sigma_of_the_tape_is_refused(network: Path, sigma: str, cli: Cli) -> None:
    assert "--tape-sigma" in cli.refused("distances", network, "--tape-sigma", sigma)


def test_network_of_one_camera_has_no_distance(tmp_path: Path, cli: Cli) -> None:
    alone = make_network({"hall": PLACES["hall"]})
    save_network(tmp_path, alone, covariance=joint()[:6, :6], trajectories={})
    assert "fewer than two cameras" in cli.refused("distances", tmp_path)
