"""What the bus says becomes what the page shows."""

import math

import numpy as np
import pytest

from trigpoint.contract import topics
from trigpoint.contract.messages import Polygon, PoseEstimate, PoseStamped
from trigpoint.geometry import Pose
from trigpoint.testing.views import looking_at
from trigpoint.tools.board.entities import Entities
from trigpoint.tools.board.scene import Scene

S = 1_000_000_000
COVARIANCE = np.diag([4e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4])


def scene() -> Scene:
    found = Scene("lab", ["c1", "c2"], ["r1"])
    found.changed()
    return found


def changed(shown: Scene, now_ns: int) -> Entities:
    shown.age(now_ns)
    return shown.changed()


def place(shown: Scene, name: str, estimate: PoseEstimate, received_ns: int) -> None:
    entity = f"{'robot' if name.startswith('r') else 'camera'}/{name}"
    pose, covariance = Pose.stack([estimate.pose]), estimate.covariance[None]
    shown.take_poses([entity], pose, covariance, [received_ns])


def robot_pose(x: float, y: float, heading: float) -> PoseEstimate:
    return PoseEstimate(0, "map", Pose.planar(x, y, heading), COVARIANCE)


def camera_pose() -> PoseEstimate:
    """2 m up, looking along y, 30° down."""
    pose = looking_at([1.0, 2.0, 2.0], [1.0, 2.0 + math.cos(math.pi / 6), 1.5])
    return PoseEstimate(0, "map", pose, np.eye(6) * 1e-4)


def test_a_camera_is_unseen_then_undetermined_then_located() -> None:
    shown = Scene("lab", ["c1"], [])
    assert changed(shown, 0)["camera/c1"]["state"] == "unseen"
    shown.report("edge/c1", {"faces.total": "0", "faces.rate": "0.0"}, S)
    shown.report("edge/own_c9", {"faces.total": "5"}, S)  # of another site
    shown.report("edge/c1", {"faces.total": "many"}, S)
    assert not changed(shown, S)
    shown.report("edge/c1", {"faces.total": "7", "faces.rate": "3.5"}, 2 * S)
    assert changed(shown, 2 * S)["camera/c1"] == {"state": "undetermined", "seen": 2}
    place(shown, "c1", camera_pose(), 3 * S)
    camera = changed(shown, 3 * S)["camera/c1"]
    assert camera["state"] == "located"
    assert camera["at"] == [1.0, 2.0, 2.0]
    assert camera["look"] == [round(math.pi / 2, 3), round(-math.pi / 6, 3)]


def test_a_robot_has_its_place_and_its_ellipse() -> None:
    shown = scene()
    place(shown, "r1", robot_pose(1.23456, -2.0, 0.5), S)
    robot = changed(shown, S)["robot/r1"]
    assert robot["at"] == [1.235, -2.0, 0.5]
    # 95 % of a plane's normal distribution lie within 2.4477 sigmas.
    assert robot["ellipse"] == [pytest.approx(0.049), pytest.approx(0.024), 0.0]
    assert robot["sigma"] == pytest.approx(0.022)
    assert not robot["stale"]


def test_the_ellipse_lies_along_the_worst_direction() -> None:
    turn = np.array([[math.cos(1.0), -math.sin(1.0)], [math.sin(1.0), math.cos(1.0)]])
    covariance = COVARIANCE.copy()
    covariance[:2, :2] = turn @ np.diag([9e-4, 1e-4]) @ turn.T
    shown = scene()
    estimate = PoseEstimate(0, "map", Pose.planar(0, 0, 0), covariance)
    place(shown, "r1", estimate, S)
    ellipse = changed(shown, S)["robot/r1"]["ellipse"]
    assert isinstance(ellipse, list)
    assert ellipse[2] == pytest.approx(1.0)


def test_who_is_silent_is_stale_and_who_comes_back_is_not() -> None:
    shown = scene()
    place(shown, "r1", robot_pose(0, 0, 0), S)
    changed(shown, S)
    assert not changed(shown, 2 * S)
    assert changed(shown, 4 * S)["robot/r1"]["stale"] is True
    place(shown, "r1", robot_pose(0, 0, 0), 5 * S)
    assert changed(shown, 5 * S)["robot/r1"]["stale"] is False


def test_a_camera_that_is_announced_no_more_while_others_are_is_undetermined() -> None:
    shown = scene()
    for name in ("c1", "c2"):
        place(shown, name, camera_pose(), S)
    for second in range(2, 14):
        place(shown, "c2", camera_pose(), second * S)
        changed(shown, second * S)
    place(shown, "c2", camera_pose(), 14 * S)
    assert changed(shown, 14 * S)["camera/c2"]["state"] == "located"
    assert shown._fields["camera/c1"]["state"] == "undetermined"


def test_all_cameras_stay_located_where_fusion_is_away() -> None:
    shown = scene()
    for name in ("c1", "c2"):
        place(shown, name, camera_pose(), S)
    cameras = changed(shown, 60 * S)
    assert {camera["state"] for camera in cameras.values()} == {"located"}
    assert all(camera["stale"] for camera in cameras.values())


def test_a_correction_is_a_time_and_a_suggestion_ends() -> None:
    shown = scene()
    shown.report("fusion/fusion", corrections(9, rate=9.9), 7 * S)
    shown.report("fusion/fusion", corrections(9), 8 * S)
    goal = PoseStamped(0, "map", Pose.planar(1, 2, 0.1))
    shown.take(topics.SUGGESTION, "r1", goal, 7 * S)
    robot = changed(shown, 7 * S)["robot/r1"]
    assert (robot["fixed"], robot["goal"]) == (7, [1.0, 2.0, 0.1])
    assert "at" not in robot  # a correction is not where the robot is
    assert changed(shown, 60 * S)["robot/r1"]["goal"] is None


def corrections(total: int, *, rate: float = 0.0) -> dict[str, str]:
    counter = "sent lab/robot/r1/correction"
    return {f"{counter}.total": str(total), f"{counter}.rate": str(rate)}


@pytest.mark.parametrize(
    ("totals", "fixed"),
    [
        ([50], None),  # before anybody looked
        ([50, 50], None),
        ([50, 51], 2),  # the report between, with the rate, was lost
        ([50, 51, 51], 2),
        ([50, 3], 2),  # of a fusion that was started anew
        ([50, 0], None),
        ([50, 0, 1], 3),
    ],
)
def test_a_correction_is_shown_where_the_report_of_its_second_is_lost(
    totals: list[int], fixed: int | None
) -> None:
    shown = scene()
    for second, total in enumerate(totals, 1):
        shown.report("fusion/fusion", corrections(total), second * S)
    assert changed(shown, 9 * S).get("robot/r1", {}).get("fixed") == fixed


def test_an_outline_keeps_its_corners_and_loses_what_lies_between() -> None:
    side = np.linspace(0, 4, 50)
    square = np.concatenate([
        np.stack([side, 0 * side, 0 * side], axis=-1),
        np.stack([4 + 0 * side, side, 0 * side], axis=-1),
        np.stack([side[::-1], 4 + 0 * side, 0 * side], axis=-1),
    ])  # fmt: skip
    shown = scene()
    shown.take(topics.COVERAGE, "c1", Polygon(0, "map", square), S)
    assert changed(shown, S)["camera/c1"]["floor"] == [0, 0, 4, 0, 4, 4, 0, 4]


def test_an_outline_is_never_further_off_than_is_said() -> None:
    angles = np.linspace(0, 6, 400)
    radii = 3 + np.sin(7 * angles)
    points = np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * angles], axis=-1)
    shown = scene()
    shown.take(topics.COVERAGE, "c1", Polygon(0, "map", points), S)
    floor = np.array(floor_of(shown)).reshape(-1, 2)
    assert len(floor) < 120
    for point in points[:, :2]:
        assert _distance(point, floor) < 0.05 + 0.01  # centimetres are rounded


def floor_of(shown: Scene) -> list[float]:
    floor = changed(shown, S)["camera/c1"]["floor"]
    assert isinstance(floor, list)
    return floor


def _distance(point: np.ndarray, line: np.ndarray) -> float:
    begin, along = line[:-1], np.diff(line, axis=0)
    share = np.clip(np.sum((point - begin) * along, axis=1) / np.sum(along**2, axis=1), 0, 1)
    return float(np.min(np.linalg.norm(begin + share[:, None] * along - point, axis=1)))
