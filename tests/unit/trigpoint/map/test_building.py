"""The map in its building: site file, plan, network carried over."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.builders import site_text
from support.fusion.networks import located

from trigpoint.base.errors import ConfigError
from trigpoint.geometry import Pose
from trigpoint.map.building import (
    attached_plan,
    carried,
    lay_map,
    lay_network,
    load_plan,
    save_building,
)
from trigpoint.map.network import (
    Network,
    PoseRecord,
    RobotRecord,
    Statistics,
    TargetRecord,
    load_covariance,
    load_network,
)
from trigpoint.recorder.writing.attachments import site_files
from trigpoint.site.config import Site, parse_site

TRUE = Pose.planar(20.0, 10.0, 0.7)
PLACES = np.array([[1.0, 0.5, 2.5], [6.0, 0.5, 2.5], [6.0, 4.5, 2.5], [1.0, 4.5, 2.5]])
PLAN = "image: plan.png\nresolution: 0.05\norigin: [18.0, 8.0, 0.1]\nnegate: 0\n"


def site(text: str, folder: Path = Path()) -> Site:
    return parse_site(site_text(cameras=4, more=text), directory=folder)


def surveyed(*, sigma: float = 0.01) -> str:
    rows = ["[map]"]
    for i, place in enumerate(TRUE @ PLACES):
        rows.append(f"[map.points.c{i + 1}]\nposition = {place.tolist()}\nsigma = {sigma}")
    return "\n".join(rows)


def network(joint: np.ndarray, places: np.ndarray = PLACES) -> Network:
    cameras = {
        f"c{i + 1}": located(Pose.from_vector([*place, 0.1, 1.5, 0.2]), joint, i)
        for i, place in enumerate(places)
    }
    robot = RobotRecord("r1.tum", 1.0, 1.0, PoseRecord.of(Pose.identity()), TargetRecord(()))
    return Network("lab", "id", "smoother", cameras, {"r1": robot}, Statistics(1.0, 3))


def joint_covariance(rng: np.random.Generator, size_m: float = 0.003) -> np.ndarray:
    root = rng.normal(size=(24, 24)) * size_m
    return root @ root.T


def test_a_network_is_carried_over_with_the_covariance_that_its_errors_have() -> None:
    rng = np.random.default_rng(1)
    joint, ratios = joint_covariance(rng), []
    for _ in range(40):
        errors = rng.multivariate_normal(np.zeros(24), joint).reshape(4, 6)
        in_map = PLACES + errors[:, :3]
        measured = TRUE @ PLACES + rng.normal(scale=0.01, size=PLACES.shape)
        points = "\n".join(
            f"[map.points.c{i + 1}]\nposition = {place.tolist()}"
            for i, place in enumerate(measured)
        )
        here = site(f"[map]\n{points}")
        found = network(joint, in_map)
        building = lay_network(here, None, found, joint, {})
        assert building is not None
        moved, covariance = carried(building, found, joint)
        records = [moved.cameras[name].map_from_camera for name in moved.located]
        places = np.array([record.translation for record in records if record is not None])
        rows = [6 * i + axis for i in range(4) for axis in range(3)]
        off = (places - TRUE @ PLACES).reshape(-1)
        ratios.append(off @ np.linalg.solve(covariance[np.ix_(rows, rows)], off) / 12)
    assert abs(np.mean(ratios) - 1) < 4 * np.sqrt(2 / 12 / len(ratios))


def test_well_surveyed_cameras_are_known_in_the_building_as_well_as_they_were_surveyed() -> None:
    joint = np.kron(np.ones((4, 4)), np.diag([0.25, 0.25, 0.25, 0, 0, 0])) + 1e-8 * np.eye(24)
    found = network(joint)
    building = lay_network(site(surveyed(sigma=0.002)), None, found, joint, {})
    assert building is not None
    moved, _ = carried(building, found, joint)
    # They err together by half a metre in the map, which the survey takes out.
    assert all(moved.cameras[name].position_sigma < 0.004 for name in moved.located)
    assert moved.map == "building"


def test_what_is_written_is_a_network_like_any_other(tmp_path: Path) -> None:
    joint = joint_covariance(np.random.default_rng(2))
    found = network(joint)
    ways = {"r1": (np.arange(3) * 10**9, Pose.planar([0, 1, 2], [0, 0, 0], [0, 0, 0]))}
    building = lay_network(site(surveyed()), None, found, joint, ways)
    assert building is not None
    there = save_building(tmp_path, building, found, joint, ways)
    again = load_network(there)
    assert again.map == "building"
    assert load_covariance(there, again).shape == (24, 24)
    first = (there / "r1.tum").read_text().split()
    assert [float(v) for v in first[1:3]] == pytest.approx([20.0, 10.0], abs=0.05)
    assert b'"offset"' in (tmp_path / "alignment.json").read_bytes()


def test_a_mark_is_where_the_robot_stood_then() -> None:
    text = surveyed() + (
        "\n[map.points.dock]\nrobot = 'r1'\nat = 2.0\nposition = "
        f"{(TRUE @ np.array([2.0, 0.0, 0.0])).tolist()}"
    )
    joint = joint_covariance(np.random.default_rng(2))
    ways = {"r1": (np.arange(4) * 10**9, Pose.planar([0, 1, 2, 3], [0] * 4, [0] * 4))}
    building = lay_network(site(text), None, network(joint), joint, ways)
    assert building is not None
    assert building.laying is not None
    assert [one.name for one in building.laying.residuals][-1] == "dock"
    assert building.laying.residuals[-1].distance_m < 0.05
    short = {"r1": (ways["r1"][0][:2], ways["r1"][1][:2])}
    again = lay_network(site(text), None, network(joint), joint, short)
    assert again is not None
    assert again.missing == ("dock",)


def write_plan(folder: Path, text: str = PLAN) -> None:
    (folder / "plan.yaml").write_text(text)
    pixels = np.full((200, 300), 255, np.uint8)
    pixels[20, 30] = 0
    Image.fromarray(pixels).save(folder / "plan.png")


def test_a_plans_pixels_are_where_map_server_has_them(tmp_path: Path) -> None:
    write_plan(tmp_path)
    plan = load_plan(site('[map]\nplan = "plan.yaml"', tmp_path))
    assert plan is not None
    frame_from_plan = Pose.planar(18.0, 8.0, 0.1)
    # Row 0 is the upper one, 200 rows above the origin; a pixel's place is its centre.
    expected = frame_from_plan @ np.array([30.5 * 0.05, (200 - 20.5) * 0.05, 0.0])
    assert plan.position((30, 20)) == pytest.approx(expected[:2])
    small = plan.reduced(100)
    assert small.pixels.shape == (67, 100)
    assert small.pixels.min() == 0  # the one dark pixel stays
    assert small.corners[0] == pytest.approx(plan.corners[0])


def test_points_may_be_pixels_of_the_plan(tmp_path: Path) -> None:
    write_plan(tmp_path)
    text = '[map]\nplan = "plan.yaml"\n'
    text += "".join(
        f"[map.points.c{i + 1}]\npixel = [{u}, {v}]\n"
        for i, (u, v) in enumerate([(10, 180), (110, 180), (110, 100), (10, 100)])
    )
    here = site(text, tmp_path)
    assert here.map is not None
    places = {f"c{i + 1}": place for i, place in enumerate(PLACES)}
    building = lay_map(
        here.map, load_plan(here), places, lambda names: 1e-6 * np.eye(3 * len(names))
    )
    assert building.frame_from_map.heading == pytest.approx(0.1, abs=1e-6)
    assert building.laying is not None
    assert max(one.distance_m for one in building.laying.residuals) < 1e-6


def test_a_session_carries_its_plan(tmp_path: Path) -> None:
    write_plan(tmp_path)
    here = site('[map]\nplan = "plan.yaml"\norigin = [1.0, 2.0, 0.5]', tmp_path)
    (tmp_path / "target.toml").write_text(_TARGET)
    attachments = {name: data for name, data, _ in site_files(here)}
    plan = attached_plan(here, attachments)
    assert plan is not None
    assert plan.size_m == pytest.approx((15.0, 10.0))
    building = lay_network(here, plan, network(np.eye(24)), np.eye(24), {})
    assert building is not None
    assert building.frame_from_map.heading == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[map]", "map: .map. says nothing; give points, an origin or a plan"),
        ("[map.points.c9]\nposition = [1, 2]", "there is no camera «c9»; did you mean"),
        ("[map.points.c1]\nposition = [1]", "has 1 numbers; write .x, y. or .x, y, z."),
        ("[map.points.c1]\nsigma = 0.1", "either `position` .m. or `pixel`"),
        ("[map.points.c1]\npixel = [1, 2]", "is a pixel of no plan; give `plan` too"),
        ("[map.points.d]\nrobot = 'r7'\nposition = [1, 2]", "there is no robot «r7»"),
        ("[map.points.c1]\nrobot = 'r1'\nposition = [1, 2]", "a mark needs another name"),
        ("[map]\nlevel = false\n[map.points.c1]\nposition = [1, 2]", "has no z, which level"),
        ("[map]\nframe = 'map'\norigin = [0, 0, 0]", "call the building's otherwise"),
        ("[map]\norigin = [0, 0, 0]\n[map.points.c1]\nposition = [1, 2]", "say the same twice"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        site(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image: plan.png\norigin: [0, 0, 0]", "needs the key «resolution»"),
        (PLAN.replace("0.05", "no"), "`resolution` is a number of metres"),
        (PLAN.replace("0.05", "-1"), "`resolution` must be above 0"),
        (PLAN.replace("plan.png", "none.png"), "the plan's picture .*none.png cannot be read"),
        (PLAN.replace("plan.png", "plan.yaml"), "is no picture .*; give a PNG or PGM"),
        ("image: [", "not valid YAML"),
    ],
)
def test_a_wrong_plan_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    write_plan(tmp_path, text)
    with pytest.raises(ConfigError, match=said) as caught:
        load_plan(site('[map]\nplan = "plan.yaml"', tmp_path))
    assert "\n" not in str(caught.value)


_TARGET = """name = "one"
[[faces]]
id = 0
pattern = "checkerboard"
columns = 9
rows = 6
square = 0.03
translation = [0, 0, 0]
quaternion = [0, 0, 0, 1]
"""
