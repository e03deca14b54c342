"""The page of a calibration as a reader's browser gets it."""

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from playwright.sync_api import Browser
from support.browser import browser, chromium, is_patient, needs_chromium, opened
from support.commands import Cli
from support.fusion.drives import (
    CameraPlan,
    lab_cameras,
    lab_plan,
    make_session,
    write_session,
)
from support.fusion.networks import located as made_located
from support.pages import read_page

from trigpoint.fusion.estimators.residuals import CameraResiduals
from trigpoint.fusion.guidance.suggestions import Suggestion
from trigpoint.geometry import CameraModel, Pose
from trigpoint.map.building import Building
from trigpoint.map.floor_plan import FloorPlan
from trigpoint.map.network import (
    AlternativeRecord,
    CameraRecord,
    IntrinsicsRecord,
    Network,
    PoseRecord,
    Statistics,
)
from trigpoint.map.survey import SurveyedPoint, lay
from trigpoint.testing.views import looking_at
from trigpoint.tools.pages.residual_charts import covered_share
from trigpoint.tools.report.calibration.facts import (
    CalibrationResults,
    view_angle_sigmas,
    view_angles,
)
from trigpoint.tools.report.calibration.page import calibration_page
from trigpoint.tools.report.calibration.tables import used_table

__all__ = ["browser", "chromium"]  # the fixtures
LENS = CameraModel(640, 480, 500.0, 501.0, 320.0, 240.0, (-0.2, 0.05, 1e-3, 0.0, 0.0))
EYE = looking_at((2.0, 0.0, 1.6), (0.0, 0.0, 0.6))


def words(page: str) -> str:
    return read_page(page).text


def located(place: tuple[float, float, float] = (2.0, 0.0, 1.6), sigma: float = 0.02):
    pose = Pose(EYE.rotation, np.array(place))
    covariance = np.diag([sigma**2 / 3] * 3 + [1e-4] * 3)
    return made_located(
        pose,
        covariance,
        intrinsics=IntrinsicsRecord.of(LENS, np.array([1.5, 1.6, 0.7, 0.8, 0.01, 0.02, 0, 0, 0])),
        sightings=12,
        rejected=2,
        time_offset=0.012,
        time_offset_sigma=0.001,
        reprojection_rms=0.2,
    )


def residuals(count: int = 60, wild: int = 3) -> CameraResiduals:
    random = np.random.default_rng(2)
    pixels = random.uniform([0, 240], [639, 479], (count, 2))
    used = np.arange(count) >= wild
    return CameraResiduals(
        np.zeros((2, 3)), pixels, random.normal(0, 0.2, (count, 2)), np.full(count, 0.2),
        used,
    )  # fmt: skip


def make_results(**more) -> CalibrationResults:
    cameras = more.pop("cameras", {"c1": located(), "c2": located((2.0, 3.0, 1.6), 0.05)})
    count = sum(camera.status == "located" for camera in cameras.values())
    way = Pose.planar(np.linspace(0, 1, 20), np.linspace(0, 3, 20), 0.3)
    goal = Pose.planar(0.4, 1.0, 1.5)
    fields = {
        "network": Network("lab", "uuid", "smoother", cameras, {}, Statistics(0.98, 7)),
        "covariance": np.eye(6 * count) * 1e-4,
        "trajectories": {"r1": (np.arange(20) * 10**9, way)},
        "residuals": {name: residuals() for name in cameras},
        "left_out": {},
        "notes": [],
        "suggestions": (Suggestion("r1", goal, "c2", 0.05, 0.03, ("c1", "c2")),),
        "error": None,
        "session": "drive/session.mcap",
        "folder": "drive/calibration",
    }
    return CalibrationResults(**(fields | more))


def surveyed() -> Building:
    """A map that is laid over two cameras, with a plan below it; a third point is missing."""
    plan = FloorPlan(np.full((30, 40), 200, np.uint8), 0.1, Pose.planar(9.0, 8.0, 0.2))
    points = [
        SurveyedPoint(name, np.array(ours), np.add(ours, [10.0, 10.0, 0.0]), 0.01)
        for name, ours in (("c1", [2.0, 0.0, 1.6]), ("c2", [2.0, 3.0, 1.6]))
    ]
    laying = lay(points, 1e-4 * np.eye(6), is_level=True)
    return Building("hall", laying.frame_from_map, plan, laying, ("dock",))


UNDETERMINED = CameraRecord("undetermined", undetermined=("which face it saw",), sightings=4)
KINDS = {
    "good": make_results(),
    "nothing located": make_results(
        cameras={"c1": UNDETERMINED, "c2": CameraRecord("unseen")}, suggestions=()
    ),
    "nothing at all": make_results(
        cameras={"c1": CameraRecord("unseen")}, suggestions=(), trajectories={}, residuals={}
    ),
    "in a building": make_results(building=surveyed()),
    "in no building": make_results(building_problem="c1, c2 do not tell the map's direction"),
    "no residuals": make_results(residuals={}),
    "robot stood": make_results(
        trajectories={"r1": (np.arange(3), Pose.planar(np.zeros(3), 0.0, 0.0))}
    ),
    "all corners wild": make_results(residuals={"c1": residuals(5, 5), "c2": residuals(0, 0)}),
    "one corner": make_results(residuals={"c1": residuals(1, 0), "c2": residuals(2, 1)}),
}


@pytest.mark.parametrize("results", KINDS.values(), ids=KINDS.keys())
def test_page_is_whole_and_every_number_in_it_is_one(results: CalibrationResults) -> None:
    text = words(calibration_page(results))
    assert not {"nan", "inf", "None", "nan°", "-0.00"} & set(text.split())


def test_intrinsics_stand_with_their_sigmas_and_known_ones_say_so() -> None:
    text = words(calibration_page(make_results()))
    for shown in ("fx 500.00 px 1.50 px", "cy 240.00 px 0.80 px", "k2 0.05000 0.02000"):
        assert shown in text
    assert "p1 0.00100 taken as known" in text
    assert "k3 0.00000 taken as known" in text
    assert "time offset 12.00 ms 1.00 ms" in text


def test_what_became_of_sightings_is_as_the_network_has_it() -> None:
    shown = used_table(make_results(cameras={"c1": located(), "c2": UNDETERMINED}))
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", shown, re.DOTALL)
    cells = [re.findall(r"<td[^>]*>([0-9]+)</td>", each) for each in rows]
    # Used, contradicting the rest, not read; then corners.
    assert cells[1:] == [["10", "2", "0", "57", "3"], ["0", "0", "4", "57", "3"]]


def test_undetermined_camera_tells_why_and_where_the_robot_stood() -> None:
    cameras = {"c1": located(), "c2": UNDETERMINED, "c3": CameraRecord("unseen")}
    text = words(calibration_page(make_results(cameras=cameras)))
    assert "1 of 3 cameras located" in text
    assert (
        "which face it saw. It saw the target 4 times, once with the robot near (0.0, 0.0) m"
        in text
    )
    assert "c3 : it never saw a robot's target" in text


def test_places_that_are_left_open_are_on_the_map_and_come_first() -> None:
    places = tuple(
        AlternativeRecord(PoseRecord.of(Pose(EYE.rotation, np.array([x, 1.0, 1.6]))), (), share)
        for x, share in ((7.0, 0.6), (9.0, 0.4))
    )
    cameras = {"c1": located(), "c2": msgspec.structs.replace(UNDETERMINED, alternatives=places)}
    page = calibration_page(make_results(cameras=cameras))
    assert "c2, 60.0 %" in page
    assert "c2, 40.0 %" in page
    assert "First drive past c2 again" in words(page)
    assert "c1, 60" not in page


def test_camera_on_one_sighting_is_named() -> None:
    alone = msgspec.structs.replace(located((2.0, 3.0, 1.6), 0.05), confirmed=False)
    text = words(calibration_page(make_results(cameras={"c1": located(), "c2": alone})))
    assert "c2 rests on one sighting alone" in text
    assert "c1 rests" not in text


def test_next_pose_stands_with_what_it_improves() -> None:
    text = words(calibration_page(make_results()))
    assert "The camera that is known worst is c2, to 5.00 cm" in text
    assert "1 r1 0.40 1.00 86 c1, c2 c2 5.00 3.00" in text
    nothing = words(calibration_page(make_results(suggestions=())))
    assert "No single picture more" in nothing


def test_what_was_left_out_stands_in_words() -> None:
    notes = ["camera c3 sends", "robot r1 was put down"]
    text = words(calibration_page(make_results(left_out={"wrong_size": 7}, notes=notes)))
    assert "pictures of another size than the camera's intrinsics are for 7" in text
    assert "camera c3 sends" in text
    assert "robot r1 was put down" in text
    assert "c1 10 2 0 57 3" in text  # used, rejected, not read, corners, wild ones


def test_noise_that_is_not_as_stated_stands_in_words() -> None:
    line = "c2: 1.8 times the stated sigma of corners"
    assert f"where noise is as assumed, that is, of {line}" in words(
        calibration_page(make_results(noise=(line,)))
    )
    assert "that is, of" not in words(calibration_page(make_results()))


def test_names_from_files_cannot_break_the_page() -> None:
    results = make_results(notes=["<script>"], left_out={"<b>": 1}, session="a&b <i>.mcap")
    assert "trigpoint review a&b <i>.mcap" in words(calibration_page(results))


def test_many_cameras_are_folded() -> None:
    cameras = {f"c{i}": located((2.0, float(i), 1.6)) for i in range(12)}
    page = calibration_page(make_results(cameras=cameras))
    assert '<details class="camera card k0">' in page
    assert 'class="camera card k0" open' in calibration_page(make_results())


def test_angles_are_those_of_the_camera() -> None:
    assert view_angles(EYE) == pytest.approx([180.0, np.degrees(np.arctan2(1, 2)), 0.0], abs=1e-9)
    spun = Pose(EYE.rotation @ Pose.planar(0, 0, 0.1).rotation, EYE.translation)
    assert view_angles(spun)[2] == pytest.approx(np.degrees(0.1))


def test_angle_sigmas_are_those_of_drawn_poses() -> None:
    root = 1e-3 * np.random.default_rng(1).standard_normal((6, 6))
    covariance = root @ root.T
    pose = Pose(EYE.rotation, EYE.translation).disturbed([0, 0, 0, 0.1, 0.2, 0.9])
    draws = np.random.default_rng(2).multivariate_normal(np.zeros(6), covariance, 4000)
    sampled = np.std([view_angles(pose.disturbed(draw)) for draw in draws], axis=0)
    np.testing.assert_allclose(view_angle_sigmas(pose, covariance), sampled, rtol=0.06)


def test_covered_share_counts_the_fields_of_the_picture() -> None:
    found = replace(residuals(1, 0), pixels=np.array([[3.0, 3.0]]))
    assert covered_share(found, 640, 480) == pytest.approx(1 / 192)


def test_calibrate_leaves_the_page_beside_the_network(tmp_path: Path, cli: Cli) -> None:
    cameras = lab_cameras()
    cameras["far"] = CameraPlan(looking_at((90.0, 0.0, 1.6), (95.0, 0.0, 0.6)))
    session = make_session(lab_plan(cameras=cameras, picture_rate=1.0))
    folder = write_session(session, tmp_path / "drive")
    assert (
        str(tmp_path / "out" / "report.html")
        in cli("calibrate", folder, "--out", tmp_path / "out").out
    )
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    text = words(page)
    assert "3 of 4 cameras located" in text
    assert "far : it never saw a robot's target" in text
    assert re.search(r"1 r1 -?\d+\.\d\d -?\d+\.\d\d -?\d+ .* c\d", text)
    deviations = re.findall(r"Standard deviation (\d\.\d\d) sigmas", text)
    assert len(deviations) == 3
    assert all(0.8 < float(value) < 1.1 for value in deviations)


def test_a_floor_plan_lies_under_the_map_within_the_page() -> None:
    page = calibration_page(make_results(building=surveyed()))
    sources = [value for name, value in read_page(page).attributes if name == "href"]
    assert any(value.startswith("data:image/png;base64,") for value in sources)
    text = words(page)
    assert "The map in hall: (10.000, 10.000, 0.000) m" in text
    assert "dock is not located" in text


@is_patient
@needs_chromium
def test_numbers_with_long_words_stand_in_three_columns_on_paper(
    browser: Browser, tmp_path: Path
) -> None:
    """In six, each as narrow as a word, they took a page."""
    noise = tuple(f"c{number}: 1.8 times the stated sigma of corners" for number in range(6))
    path = tmp_path / "report.html"
    path.write_text(calibration_page(make_results(noise=noise)), encoding="utf-8")
    page, _ = opened(browser, path.as_uri(), viewport={"width": 720, "height": 900})
    page.emulate_media(media="print")
    boxes = [box for tile in page.locator(".tile").all() if (box := tile.bounding_box())]
    assert [box["y"] == boxes[0]["y"] for box in boxes[:4]] == [True, True, True, False]
