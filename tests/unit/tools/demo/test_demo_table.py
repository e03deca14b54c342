import numpy as np
from support.builders_demo import make_camera, make_key, make_results, make_unlocated

from trigpoint.tools.report.demo.lines import table


def line_of(text: str, start: str) -> str:
    return next(line for line in text.splitlines() if line.strip().startswith(start))


def test_each_camera_has_its_error_and_sigma_in_centimetres():
    words = line_of(table(make_results()), "c1").split()
    assert words[:3] == ["c1", "1.00", "1.73"]
    assert words[5:] == ["1.0", "100", "0"]


def test_camera_that_was_not_met_says_so():
    results = make_results(cameras=(make_camera("c1"), make_unlocated("c2", came_by=False)))
    assert "not met" in line_of(table(results), "c2")


def test_reason_of_an_undetermined_camera_is_told():
    camera = make_unlocated("c2", came_by=True, status="undetermined", undetermined=("its height",))
    text = table(make_results(cameras=(make_camera("c1"), camera)))
    assert "c2 is not determined: its height" in text


def test_machine_that_was_too_busy_for_its_cameras_is_told():
    busy = make_camera("c1", pictures=80, skipped=20, given_up=5)
    idle = make_camera("c2", place=(0.0, 2.0, 1.5), pictures=100, skipped=0)
    text = table(make_results(cameras=(busy, idle)))
    assert "too busy for its cameras: of 200 pictures 20 were missed and 5 searched in part" in text
    little = make_camera("c1", pictures=98, skipped=2, given_up=1)
    assert "too busy" not in table(make_results(cameras=(little,)))


def test_paper_stands_beside_the_distance_error():
    text = table(make_results())
    assert line_of(text, "distances between").endswith("0.40 cm")
    assert line_of(text, "the paper's").endswith("2.11 cm")


def test_bound_is_shown_only_where_it_is_known():
    assert "Cramér–Rao" not in table(make_results())
    text = table(make_results(bound_m=0.003))
    assert line_of(text, "expected at the Cramér–Rao bound").endswith("0.30 cm")


def test_robots_errors_are_dead_reckoned_and_corrected():
    text = table(make_results())
    assert "10.00 cm" in line_of(text, "odometry alone")
    assert "1.00 cm" in line_of(text, "as fusion said")
    assert "2.00 cm" in line_of(text, "as the robot itself")


def test_keys_of_one_kind_are_added_up():
    keys = (make_key("camera/c1/sightings"), make_key("camera/c2/sightings", recorded=90))
    results = make_results(keys=keys)
    words = line_of(table(results), "camera/*/sightings").split()
    assert words == ["camera/*/sightings", "2", "200", "200", "190", "NOT", "ALL"]
    assert [kind.path for kind in results.kinds] == ["camera/*/sightings"]


def test_latencies_are_given_as_median_and_95_percent():
    text = table(make_results(latencies_s=np.linspace(0.0, 0.1, 101)))
    assert "101 of them: p50 50 ms, p95 95 ms" in text


def test_restarted_part_is_named():
    assert "fusion ended and was started again 2 ×" in table(make_results(restarts={"fusion": 2}))


def test_counts_that_a_restart_broke_are_not_told_as_losses():
    keys = (make_key("robot/r1/odom", sent=100, recorded=90),)
    assert line_of(table(make_results(keys=keys)), "robot/*/odom").endswith("NOT ALL")
    restarted = make_results(keys=keys, restarts={"recorder": 1})
    assert line_of(table(restarted), "robot/*/odom").endswith("a part began anew")
    whole = make_results(keys=(make_key("robot/r1/odom"),), restarts={"recorder": 1})
    assert line_of(table(whole), "robot/*/odom").endswith("all")
