"""A lens that is not the camera's is said, and odometry of other lengths; what is as it is told is
not said, whatever else is wrong."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace
from support.commands import Cli
from support.fusion.drives import Plan, lab_plan, make_session, pushed, write_session

from trigpoint.contract.messages import Sightings
from trigpoint.geometry import CameraModel
from trigpoint.map.network import load_network

Change = Callable[[CameraModel], CameraModel]


def told(plan: Plan, change: Change, *cameras: str) -> Plan:
    """The drive where these cameras' lenses are told otherwise than they are."""
    wrong = {
        name: replace(plan.cameras[name], told=change(plan.cameras[name].lens)) for name in cameras
    }
    return replace(plan, cameras=plan.cameras | wrong)


def longer(times: float) -> Change:
    return lambda lens: replace(lens, fx=times * lens.fx, fy=times * lens.fy)


def exchanged(lens: CameraModel) -> CameraModel:
    return replace(lens, cx=lens.cy, cy=lens.cx)


def larger(lens: CameraModel) -> CameraModel:
    """That of a picture a quarter larger."""
    return lens.with_parameters([*(1.25 * lens.parameters[:4]), *lens.distortion])


@pytest.mark.parametrize(
    ("change", "cameras", "words"),
    [
        (longer(1.02), "c1 c2 c3", r"a focal length about 1\.\d % shorter fits"),
        (longer(0.95), "c1 c2 c3", r"a focal length about [45]\.\d % longer fits"),
        (longer(0.95), "c1", r"a focal length about [45]\.\d % longer fits"),
        (exchanged, "c1 c2 c3", r"a principal point about \d+ px off fits"),
        (larger, "c1 c2 c3", r"a focal length about (19|2\d) % shorter fits"),
    ],
)
def test_a_lens_that_is_not_the_cameras_is_said(change: Change, cameras: str, words: str) -> None:
    session = make_session(told(lab_plan(picture_rate=1.0), change, *cameras.split()))
    found = pushed(session.inputs, session.messages).arrivals.unfit.lenses
    assert sorted(found) == cameras.split()
    assert all(re.fullmatch(words, lens.words) for lens in found.values())
    assert all(lens.is_harmful for lens in found.values())


def test_what_else_is_wrong_is_no_lens() -> None:
    plan = lab_plan(picture_rate=1.0)
    (robot,), cameras = plan.robots.values(), plan.cameras
    late = {name: replace(camera, time_offset_s=0.1) for name, camera in cameras.items()}
    for other, is_scaled in (
        (plan, False),
        (replace(plan, robots={"r1": replace(robot, scales=(0.1, 0.0))}), True),
        (replace(plan, robots={"r1": replace(robot, scales=(0.05, -0.05))}), True),
        (replace(plan, stated=0.05), False),
        (replace(plan, cameras=late), False),
    ):
        session = make_session(other)
        unfit = pushed(session.inputs, session.messages).arrivals.unfit
        assert not unfit.lenses
        assert bool(unfit.scales) is is_scaled


@pytest.mark.parametrize(
    ("scale", "words"), [(0.1, r"1\.1 times too short"), (-0.1, r"1\.11 times too long")]
)
def test_odometry_of_other_lengths_is_said_until_it_is_to_be_learnt(
    scale: float, words: str, tmp_path: Path, cli: Cli
) -> None:
    plan = lab_plan(picture_rate=1.0)
    robot = replace(plan.robots["r1"], scales=(scale, 0.0))
    session = make_session(replace(plan, robots={"r1": robot}))
    said = cli("calibrate", write_session(session, tmp_path / "a"), status=1)
    assert re.search(rf"r1: what cameras saw fits .* its lengths are told {words}", said.err)
    assert load_network(tmp_path / "a" / "calibration").located == []

    noise = replace(robot.noise, distance_scale=0.1)  # what is said to be written
    learnt = replace(plan, robots={"r1": replace(robot, noise=noise)})
    session = replace(session, inputs=make_session(learnt).inputs)
    said = cli("calibrate", write_session(session, tmp_path / "b"))
    assert said.err == ""
    assert load_network(tmp_path / "b" / "calibration").located == ["c1", "c2", "c3"]


@pytest.mark.parametrize("change", [longer(0.93), longer(1.1)])
def test_a_lens_is_said_also_where_what_contradicts_it_is_rejected(change: Change) -> None:
    sparse = lab_plan(picture_rate=0.2)
    for plan, wrong in ((sparse, []), (told(sparse, change, "c1"), ["c1"])):
        session = make_session(plan)
        pipeline = pushed(session.inputs, session.messages)
        assert list(pipeline.arrivals.unfit.lenses) == wrong
        assert bool(pipeline.results().network.located) is not bool(wrong)


def test_a_wrong_sighting_is_no_lens() -> None:
    session = make_session(lab_plan(picture_rate=0.3))
    messages = list(session.messages)
    at, seen = next(
        (at, message)
        for at, (node, message) in enumerate(messages)
        if isinstance(message, Sightings) and node == "c1" and len(message.faces) > 1
    )
    first, *others = seen.faces
    messages[at] = "c1", replace(seen, faces=(replace(first, pixels=first.pixels + 15), *others))
    pipeline = pushed(session.inputs, tuple(messages))
    assert pipeline.results().network.cameras["c1"].rejected == 1
    assert not pipeline.arrivals.unfit.lenses


@pytest.mark.parametrize(("rate", "seconds"), [(0.3, 22.0), (0.5, 22.0), (0.2, 44.0)])
def test_odometry_of_other_lengths_is_said_where_it_had_pictures_rejected(
    rate: float, seconds: float
) -> None:
    """What contradicts it is not used then: cameras were 30 cm off at 40 sigmas, and all fitted."""
    plan = lab_plan(picture_rate=rate, seconds=seconds)
    robot = replace(plan.robots["r1"], scales=(0.15, 0.0))
    session = make_session(replace(plan, robots={"r1": robot}))
    pipeline = pushed(session.inputs, session.messages)
    (words,) = pipeline.arrivals.odometry.otherwise.values()
    assert re.search(r"lengths are told 1\.1\d times too short", words)
    assert pipeline.results().network.located == []


def test_calibrate_gives_no_cameras_that_rest_on_other_lenses(tmp_path: Path, cli: Cli) -> None:
    plan = told(lab_plan(picture_rate=1.0), longer(0.95), "c1")
    said = cli("calibrate", write_session(make_session(plan), tmp_path), status=1)
    assert re.search(
        r"c1: its pictures do not fit its lens: .* longer fits; calibrate it", said.err
    )
    assert "no camera could be located" in said.err
    assert re.search(r"c2 is not determined: .*since pictures do not fit the lens of c1", said.out)
    assert load_network(tmp_path / "calibration").located == []
    page = (tmp_path / "calibration" / "report.html").read_text()
    assert "<h1>No camera could be located</h1>" in page
    assert page.index("do not fit its lens") < page.index("cameras located")
