"""The page as a reader's browser gets it."""

import re

import numpy as np
import pytest
from support.builders_demo import (
    make_camera,
    make_key,
    make_results,
    make_robot,
    make_unlocated,
)
from support.pages import PageReader, read_page

from trigpoint.geometry import Pose
from trigpoint.tools.pages.plan import Plan, suggestion_marks
from trigpoint.tools.report.demo.charts import latency_chart
from trigpoint.tools.report.demo.page import network_map, report_page
from trigpoint.tools.report.demo.results import DemoResults, Track


def read(results: DemoResults) -> PageReader:
    return read_page(report_page(results, folder="out"))


EMPTY = Track(np.zeros(0), np.zeros((0, 2)), np.zeros(0))

RUNS = {
    "good": make_results(),
    "one camera": make_results(cameras=(make_camera("c1"),)),
    "none located": make_results(
        cameras=(make_unlocated("c1", came_by=True), make_unlocated("c2", came_by=False)),
        series=(), latencies_s=np.zeros(0),
    ),
    "nothing counted": make_results(keys=()),
    "failed": make_results(
        cameras=(make_camera("c1", error=(0.3, 0, 0)),), keys=(make_key(sent=1),)
    ),
    "restarted": make_results(restarts={"fusion": 1}),
    "never corrected": make_results(robots=(make_robot(live=EMPTY, believed=EMPTY),)),
    "perfect": make_results(cameras=(make_camera("c1", error=(0.0, 0.0, 0.0)),)),
}  # fmt: skip


@pytest.mark.parametrize("results", RUNS.values(), ids=RUNS.keys())
def test_page_is_whole_and_has_no_number_that_is_none(results):
    text = read(results).text
    assert "nan" not in text.split()
    assert "None" not in text


def test_page_has_a_dark_and_a_printed_form():
    page = report_page(make_results(), folder="out")
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page


def test_headline_tells_how_well_it_went():
    text = read(make_results()).text
    assert "All 2 cameras located; the distances between them are right to 0.40 cm" in text


def test_missed_camera_is_the_headline_and_among_what_went_wrong():
    missed = make_unlocated("c2", came_by=True)
    text = " ".join(read(make_results(cameras=(make_camera("c1"), missed))).words)
    assert "1 of 2 cameras could not be located" in text
    assert "camera c2 was missed" in text


def test_command_that_drives_again_cuts_as_the_run_was_cut():
    assert "--seconds" not in read(make_results()).text
    cut = read(make_results(is_whole=False, seconds=16.0))
    assert "trigpoint demo --seed 3 --target charuco --out out --seconds 16" in cut.words


def test_names_from_files_cannot_break_the_page():
    key = make_key("camera/<b>&/sightings")
    reader = read(make_results(keys=(key,), target="<script>"))
    assert "camera/<b>&/sightings" in "".join(reader.words)


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_everything_lies_inside_the_map(upright, turned):
    results = make_results()
    if turned:
        walls = results.walls[..., ::-1]
        results = make_results(walls=walls, cameras=(), robots=())
    drawing = network_map(results).drawing(400.0, upright=upright)
    box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawing)
    assert box is not None
    width, height = float(box[1]), float(box[2])
    assert (width < height) == upright
    for x, y in re.findall(r'x[12]="(-?[\d.]+)" y[12]="(-?[\d.]+)"', drawing):
        assert 0 <= float(x) <= width
        assert 0 <= float(y) <= height


@pytest.mark.parametrize("upright", [False, True])
def test_map_is_turned_and_never_mirrored(upright):
    plan = network_map(make_results()).plan(400.0, upright=upright)
    origin, x, y = plan(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    across, up = x - origin, y - origin
    # The drawing's y points down, so a right-handed pair of axes turns the other way in it.
    assert across[0] * up[1] - across[1] * up[0] == pytest.approx(-(plan.scale**2))


def test_small_errors_are_drawn_larger_so_that_they_show():
    small = make_results(cameras=(make_camera("c1", error=(1e-3, 0, 0), sigma=1e-3),))
    large = make_results(cameras=(make_camera("c1", error=(0.5, 0, 0), sigma=0.5),))
    plan = network_map(small).plan(1000.0, upright=False)
    factor = network_map(small).magnification(plan)
    assert factor > 1
    assert network_map(large).magnification(plan) == 1
    assert f"drawn {factor} times larger" in read(small).text


def test_last_suggestion_is_on_the_map_where_there_was_one() -> None:
    robot = make_robot(suggestion=Pose.planar(3.0, 0.5, 1.0))
    drawn = network_map(make_results(robots=(robot,))).drawing(400.0, upright=False)
    assert 'class="next"' in drawn
    assert "last told to go next" in read(make_results(robots=(robot,))).text
    assert "last told to go next" not in read(make_results()).text


def test_marks_of_one_place_are_one_disc_with_a_nose_for_each_way_to_look() -> None:
    plan = Plan(np.array([[0.0, 0.0], [4.0, 3.0]]), 400.0, upright=False)
    poses = [Pose.planar(1.0, 1.0, 0.0), Pose.planar(3.0, 2.0, 0.0), Pose.planar(1.01, 1.0, 2.0)]
    both, alone = suggestion_marks(poses, plan)
    assert ">1, 3<" in both
    assert both.count("<polygon") == 2
    assert ">2<" in alone


def test_the_line_of_a_quantile_crosses_no_other_ones_words() -> None:
    chart = latency_chart(make_results(latencies_s=np.linspace(0.019, 0.021, 99)))
    lines = re.findall(r'<line[^>]*y1="([\d.]+)"[^>]*class="mark"', chart)
    words = re.findall(r'<text[^>]* y="([\d.]+)"[^>]*mark-text', chart)
    assert len(lines) == len(words) == 2
    assert float(lines[1]) > float(words[0])


def test_the_last_number_of_an_axis_is_not_cut() -> None:
    chart = latency_chart(make_results(latencies_s=np.linspace(0.1, 1.5, 99)))
    width = re.search(r'viewBox="0 0 ([\d.]+)', chart)
    ticks = re.findall(r'<text x="([\d.]+)"[^>]*class="tick middle[^>]*>(\d+)<', chart)
    assert width is not None
    assert ticks[-1][1] == "2000"
    assert float(ticks[-1][0]) + 4 * 10 / 2 < float(width[1])  # a digit is 10 wide on a phone
