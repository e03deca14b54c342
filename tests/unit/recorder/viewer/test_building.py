"""What lies under the cameras in rerun: the plan, and how well a robot is corrected where."""

import numpy as np
import pytest
from support.builders import make_site
from support.viewer import SECOND, FixedRows, Rows, estimate

from trigpoint.contract.messages import OccupancyGrid, PoseEstimate
from trigpoint.contract.topics import CAMERA_POSE, COVERAGE_GRID, ROBOT_POSE
from trigpoint.geometry import Pose
from trigpoint.map.floor_plan import FloorPlan
from trigpoint.recorder.viewer import style
from trigpoint.recorder.viewer.scene import Scene

PLAN = FloorPlan(np.full((40, 60), 255, np.uint8), 0.1, Pose.planar(7.0, 8.0, 0.0))
SURVEYED = "[map]\n" + "\n".join(
    f"[map.points.c{i + 1}]\nposition = [{10 - y}, {10 + x}]"  # turned by a quarter
    for i, (x, y) in enumerate([(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)])
)


@pytest.fixture
def rows() -> Rows:
    return Rows()


def surveyed_scene(rows: Rows, text: str) -> Scene:
    return Scene(make_site(cameras=4, more=text), {}, rows, plan=PLAN)


def place_cameras(scene: Scene, places: list[tuple[float, float]]) -> None:
    for i, (x, y) in enumerate(places):
        pose = Pose(np.eye(3), np.array([x, y, 2.0]))
        message = PoseEstimate(10 * SECOND + i, "map", pose, 1e-4 * np.eye(6))
        scene.add(CAMERA_POSE, f"c{i + 1}", message)
    scene.finish()


def test_the_floor_plan_lies_where_the_surveyed_cameras_say(rows: Rows) -> None:
    scene = surveyed_scene(rows, SURVEYED)
    place_cameras(scene, [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)])
    _, parts = rows.of(style.PLAN)[-1]
    # The plan's corner (7, 8) of the building is 3 m off the map's origin there, turned back.
    assert parts["translation"][0][:2] == pytest.approx([-2.0, 3.0], abs=0.01)
    turn = Pose.from_quaternion([0, 0, 0], parts["quaternion"][0])
    assert float(turn.heading) == pytest.approx(-np.pi / 2, abs=0.01)


def test_a_point_that_contradicts_the_survey_is_said(rows: Rows) -> None:
    scene = surveyed_scene(rows, SURVEYED)
    place_cameras(scene, [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 4.0)])
    said = [parts["text"][0] for _, parts in rows.of(style.LOG)]
    assert any("c4: contradicts the other surveyed points" in line for line in said)


def test_a_mark_counts_where_the_robot_stood_then(rows: Rows) -> None:
    dock = "[map.points.dock]\nrobot = 'r1'\nat = 2\nposition = [10, 11]"
    gate = "[map.points.gate]\nrobot = 'r1'\nat = 9\nposition = [10, 18]"
    scene = surveyed_scene(rows, f"{dock}\n{gate}")
    for t in range(12):
        scene.add(ROBOT_POSE, "r1", estimate(t, float(t) - 1))
    scene.finish()
    _, parts = rows.of(style.PLAN)[-1]
    assert parts["translation"][0][:2] == pytest.approx([-2.0, 3.0], abs=0.05)


def test_the_floor_is_coloured_by_how_well_a_robot_is_corrected_there() -> None:
    rows = FixedRows()
    scene = Scene(make_site(), {}, rows)
    values = np.array([[-1, 0], [99, 100]], np.int8)
    grid = OccupancyGrid(1, "map", 0.5, Pose.planar(3.0, -2.0, 0.0), values)
    scene.add(COVERAGE_GRID, "", grid)
    [mesh] = rows.meshes[style.CORRECTED]
    assert mesh.vertex_positions is not None
    assert mesh.albedo_texture_buffer is not None
    corners = mesh.vertex_positions.as_arrow_array().to_pylist()
    np.testing.assert_allclose(np.array(corners)[[0, 2], :2], [[3.0, -2.0], [4.0, -1.0]])
    texture = np.frombuffer(
        bytes(mesh.albedo_texture_buffer.as_arrow_array().to_pylist()[0]), np.uint8
    ).reshape(2, 2, 3)
    # The picture's first row is the floor's farthest.
    assert texture.tolist() == [
        [list(style.WORST), list(style.NEVER)],
        [list(style.FLOOR), list(style.BEST)],
    ]
