"""The command `coverage`, as a user runs it, and its files as other programs read them."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML
from support.commands import Cli
from support.fusion.networks import located

from trigpoint.cli import run
from trigpoint.geometry import CameraModel, Pose
from trigpoint.map.network import (
    Network,
    RobotRecord,
    Statistics,
    TargetRecord,
    save_network,
)
from trigpoint.tools.shapes.text import target_text
from trigpoint.tools.simulation.sight.targets import target_of
from trigpoint.tools.simulation.world import looking

LENS = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5, (-0.1, 0.02, 0.0, 0.0, 0.0))
PLACES = {"c1": ((0.0, 0.0, 2.0), 0.0), "c2": ((4.0, 0.5, 2.0), 170.0)}
WAY = Pose.planar(np.linspace(1.0, 3.0, 30), np.zeros(30), np.zeros(30))

CANDIDATES = """
[cameras.far]
position = [40.0, 40.0, 2.0]
yaw = 0.0
pitch = 30.0
like = "c1"
[cameras.beside]
position = [2.0, -2.5, 2.0]
yaw = 90.0
pitch = 35.0
width = 640
height = 480
horizontal_fov = 60.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    joint = np.diag([4e-6, 4e-6, 4e-6, 1e-7, 1e-7, 1e-7] * 2)
    known = {"lens": LENS, "sightings": 9, "reprojection_rms": 0.15}
    cameras = {
        name: located(Pose(looking(yaw, 35.0, 0.0), np.array(place)), joint, index, **known)
        for index, (name, (place, yaw)) in enumerate(PLACES.items())
    }
    robot = RobotRecord("r1.tum", 1.0, 1.0, None, TargetRecord(()))
    network = Network("lab", "uuid", "smoother", cameras, {"r1": robot}, Statistics(1.0, 3))
    stamps = np.arange(30) * 10**8
    out = tmp_path / "network"
    save_network(out, network, covariance=joint, trajectories={"r1": (stamps, WAY)})
    (tmp_path / "target.toml").write_text(target_text(target_of("charuco")))
    (tmp_path / "site.toml").write_text(
        'site = "lab"\ntarget = "target.toml"\n'
        + "".join(f'[cameras.{name}]\nsource = "sim://{name}"\n' for name in PLACES)
        + '[robots.r1]\nport = "/dev/ttyUSB0"\n'
    )
    (tmp_path / "places.toml").write_text(CANDIDATES)
    return tmp_path


def test_the_floor_in_figures_and_the_best_place_for_one_more_camera(
    folder: Path, cli: Cli
) -> None:
    places = str(folder / "places.toml")
    said = cli("coverage", folder / "network", "--driven", "--add", places).out
    assert "r1 is corrected" in said
    assert said.index("beside") < said.index("far")


def test_the_same_as_json(folder: Path, cli: Cli) -> None:
    places = str(folder / "places.toml")
    found = json.loads(
        cli("coverage", folder / "network", "--driven", "--add", places, "--json").out
    )
    [one] = found["maps"]
    areas = [each["area_m2"] for each in one["corrected"]]
    assert areas == sorted(areas)
    assert areas[-1] > 1.0
    assert one["corrected"][-1]["within_m"] is None
    assert any(each["lost"][-1]["area_m2"] > 0.1 for each in one["cameras"].values())
    best, other = found["candidates"]
    assert best["camera"] == "beside"
    assert best["where_one_fails"]["area_m2"] > 0.3
    assert [each["area_m2"] for each in other["gained"]] == [0.0] * 5


def test_planners_read_the_map_as_map_server_does(folder: Path) -> None:
    out = folder / "out"
    assert run(["coverage", str(folder / "network"), "--out", str(out)]) == 0
    with (out / "coverage.csv").open() as file:
        rows = list(csv.DictReader(file))
    said = YAML(typ="safe").load((out / "coverage.yaml").read_text())
    assert (said["mode"], said["negate"], said["free_thresh"], said["occupied_thresh"]) == (
        "scale", 0, 0.0, 1.0,
    )  # fmt: skip
    pixels = cv2.imread(str(out / said["image"]), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    values = np.rint((1 - pixels[..., 0] / 255) * 100).astype(int)  # nav2_map_server, scale
    values[pixels[..., 3] < 255] = -1
    for row in rows:
        column = round((float(row["x"]) - said["origin"][0]) / said["resolution"] - 0.5)
        up = round((float(row["y"]) - said["origin"][1]) / said["resolution"] - 0.5)
        error = row["error_m"]
        wanted = min(int(1000 * float(error)), 99) if error else 100
        got = int(values[len(values) - 1 - up, column])
        assert got == wanted or (error and abs(1000 * float(error) - wanted) < 0.02)
    assert np.sum(values >= 0) == len(rows)
    assert {row["worst_camera"] for row in rows} <= {"", "c1", "c2"}


def test_polygons_have_the_areas_that_they_state(folder: Path) -> None:
    out = folder / "out"
    assert run(["coverage", str(folder / "network"), "--out", str(out)]) == 0
    found = json.loads((out / "coverage.geojson").read_text())
    assert found["frame"] == "map"
    cameras = [f["properties"]["camera"] for f in found["features"] if "camera" in f["properties"]]
    assert cameras == ["c1", "c2"]
    for feature in found["features"]:
        area = 0.0
        for polygon in feature["geometry"]["coordinates"]:
            for ring in polygon:
                (x, y), (x1, y1) = np.array(ring)[:-1].T, np.array(ring)[1:].T
                area += 0.5 * float(np.sum(x * y1 - y * x1))
        assert area == pytest.approx(feature["properties"]["area_m2"], abs=0.006)


def test_only_the_floor_that_was_driven(folder: Path) -> None:
    out = folder / "out"
    assert run(["coverage", str(folder / "network"), "--driven", "--out", str(out)]) == 0
    with (out / "coverage.csv").open() as file:
        places = np.array([(float(r["x"]), float(r["y"])) for r in csv.DictReader(file)])
    assert np.abs(places[:, 1]).max() <= 0.5
    assert 0.5 <= places[:, 0].min() < places[:, 0].max() <= 3.5


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--robot", "r9"], "there is no robot «r9»"),
        (["--within", "0"], "--within 0: must be above 0"),
        (["--site", "none.toml"], "none.toml"),
        (["--add", "none.toml"], "none.toml"),
    ],
)
def test_bad_use_is_one_line(folder: Path, cli: Cli, arguments: list[str], complaint: str) -> None:
    said = cli.refused("coverage", folder / "network", *arguments)
    assert complaint in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("cameras.far", "cameras.c1", "c1 is a camera of the network"),
        ('like = "c1"', 'like = "c3"', "locates no camera «c3»"),
        ('like = "c1"', "width = 640", "a place needs one lens"),
        ("yaw = 0.0", "jaw = 0.0", "jaw"),
    ],
)
def test_a_wrong_place_is_named(folder: Path, cli: Cli, old: str, new: str, complaint: str) -> None:
    places = folder / "places.toml"
    places.write_text(CANDIDATES.replace(old, new, 1))
    said = cli.refused("coverage", folder / "network", "--add", places)
    assert complaint in said
    assert said.count("\n") == 1


def test_a_network_without_its_covariance_is_refused(folder: Path, cli: Cli) -> None:
    (folder / "network" / "covariance.npz").unlink()
    assert "keep covariance.npz beside network.json" in cli.refused("coverage", folder / "network")
