"""Which cameras moved between two networks."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.commands import Cli
from support.fusion.networks import located

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import exp
from trigpoint.map.network import Network, Statistics, encode_network
from trigpoint.tools.networks.changes import changes

SIGMA_M, SIGMA_RAD = 0.005, 0.002
MAP = Pose.planar(3.0, -2.0, 0.7)
"""The new run's robot began elsewhere."""


def drawn(
    random: np.random.Generator, *, moved: dict[str, float], new_map: Pose, count: int = 6
) -> Network:
    """A network of cameras around a room with errors drawn by their sigmas."""
    cameras = {}
    covariance = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)
    for number in range(count):
        name = f"c{number + 1}"
        angle = 2 * np.pi * number / count
        place = np.array([4 * np.cos(angle) + moved.get(name, 0.0), 3 * np.sin(angle), 2.4])
        true = new_map @ Pose(exp(np.array([1.9, angle, 0.1])), place)
        error = random.normal(size=6) * np.sqrt(np.diagonal(covariance))
        pose = Pose(exp(error[3:]) @ true.rotation, true.translation + error[:3])
        cameras[name] = located(pose, covariance)
    return Network("lab", "id", "smoother", cameras, {}, Statistics(None, 0))


@pytest.mark.parametrize("moved", [{}, {"c2": 0.1}, {"c1": 0.5, "c5": -0.06}])
def test_the_cameras_that_moved_are_told_and_no_others(moved: dict[str, float]) -> None:
    for seed in range(10):
        random = np.random.default_rng(seed)
        old = drawn(random, moved={}, new_map=Pose.identity())
        new = drawn(random, moved=moved, new_map=MAP)
        found = changes(old, new)
        assert {one.camera for one in found if one.has_moved} == set(moved)
        for one in found:
            assert one.moved_m == pytest.approx(abs(moved.get(one.camera, 0.0)), abs=0.05)


def test_chi2_is_what_it_is_said_to_be() -> None:
    """Of cameras that stayed, χ² has six degrees of freedom."""
    values = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        old = drawn(random, moved={}, new_map=Pose.identity())
        values += [one.chi2 for one in changes(old, drawn(random, moved={}, new_map=MAP))]
    assert np.mean(values) == pytest.approx(6.0, rel=0.15)


def test_the_command_compares_two_networks(tmp_path: Path, cli: Cli) -> None:
    random = np.random.default_rng(0)
    paths = [tmp_path / "old.json", tmp_path / "new.json"]
    for path, moved in zip(paths, ({}, {"c3": 0.2}), strict=True):
        path.write_bytes(encode_network(drawn(random, moved=moved, new_map=MAP)))
    rows = json.loads(cli("distances", *paths, "--json").out)["cameras"]
    assert [row["camera"] for row in rows if row["has_moved"]] == ["c3"]
    assert "moved" in cli("distances", *paths).out


def test_two_cameras_do_not_tell_which_one_moved(tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "network.json"
    network = drawn(np.random.default_rng(0), moved={}, new_map=MAP, count=2)
    path.write_bytes(encode_network(network))
    assert "at least 3" in cli.refused("distances", path, path)
