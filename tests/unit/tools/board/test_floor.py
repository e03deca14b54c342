"""The plan under the page's map, laid by what is surveyed, and the map of corrections over it."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.builders import site_text

from trigpoint.geometry import Pose
from trigpoint.site.config import parse_site
from trigpoint.tools.board.floor import Floor, grid_picture

S = 1_000_000_000
COVARIANCE = 1e-6 * np.eye(6)[None]
FRAME_FROM_MAP = Pose.planar(5.0, -2.0, 0.7)
CAMERA, MARK = np.array([0.0, 0.0, 2.0]), np.array([4.0, 3.0, 0.0])
COLUMNS, ROWS, RESOLUTION_M = 200, 100, 0.05
SITE = f"""
[map]
plan = "plan.yaml"
[map.points.c1]
position = {(FRAME_FROM_MAP @ CAMERA).tolist()}
[map.points.dock]
robot = "r1"
at = 10.0
position = {(FRAME_FROM_MAP @ MARK).tolist()}
"""


def take(floor: Floor, entity: str, place: np.ndarray, second: int) -> None:
    floor.take([entity], Pose(np.eye(3)[None], place[None]), COVARIANCE, [second * S])


def test_a_surveyed_camera_and_a_robot_on_its_mark_lay_the_plan(tmp_path: Path) -> None:
    Image.new("L", (COLUMNS, ROWS), 255).save(tmp_path / "plan.png")
    text = f"image: plan.png\nresolution: {RESOLUTION_M}\norigin: [1.0, 2.0, 0.0]\n"
    (tmp_path / "plan.yaml").write_text(text)
    floor = Floor(parse_site(site_text(cameras=2, more=SITE), directory=tmp_path))
    assert floor.fields == {"trouble": ""}
    take(floor, "camera/c2", MARK, 100)  # not surveyed
    take(floor, "robot/r1", np.array([9.0, 9.0, 0.0]), 100)  # not at its mark yet
    assert floor.fields == {"trouble": ""}
    take(floor, "camera/c1", CAMERA, 101)
    assert floor.fields["trouble"]  # a camera alone says nothing of the heading
    take(floor, "robot/r1", MARK, 111)
    assert floor.fields["trouble"] == ""
    assert floor.fields["size"] == [COLUMNS, ROWS]
    matrix = np.reshape(np.array(floor.fields["matrix"]), (3, 2)).T
    for column, row in ((0, ROWS), (COLUMNS, 0), (60, 70)):
        at = [1.0 + column * RESOLUTION_M, 2.0 + (ROWS - row) * RESOLUTION_M, 0.0]
        expected = FRAME_FROM_MAP.inverse() @ np.array(at)
        assert matrix @ [column, row, 1.0] == pytest.approx(expected[:2], abs=1e-3)


def test_cells_are_coloured_and_lie_where_they_are() -> None:
    values = np.full((30, 20), -1, dtype=np.int8)
    values[4, 7], values[5, 7] = 0, 100  # row 4, column 7: up and right of the corner
    found = grid_picture(0.5, Pose.planar(1.0, 2.0, np.pi / 2), values)
    assert found is not None
    pixels = np.asarray(Image.open(io.BytesIO(found.png)))
    assert np.argwhere(pixels[..., 3]).tolist() == [[24, 7], [25, 7]]
    best, worst = pixels[25, 7].astype(int), pixels[24, 7].astype(int)
    assert best[1] > best[0]  # green
    assert worst[0] > worst[1]  # red
    a, b, c, d, e, f = found.fields["matrix"]  # pyright: ignore
    x, y = a * 7.5 + c * 25.5 + e, b * 7.5 + d * 25.5 + f
    # The cell's middle is 3.75 m along the rows and 2.25 m across, turned by a quarter.
    assert (x, y) == pytest.approx((1.0 - 2.25, 2.0 + 3.75))
    assert found.fields["size"] == [20, 30]


def test_an_empty_grid_is_none() -> None:
    assert grid_picture(0.1, Pose.planar(0, 0, 0), np.zeros((0, 5), np.int8)) is None
