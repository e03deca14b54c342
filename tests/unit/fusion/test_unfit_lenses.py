"""A lens that is not the camera's is said; one that is its own is not, whatever else is wrong."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace
from support.commands import Cli
from support.fusion.drives import Plan, lab_plan, make_session, pushed, write_session

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
    found = pushed(session.inputs, session.messages).arrivals.lenses
    assert sorted(found) == cameras.split()
    assert all(re.fullmatch(words, lens.words) for lens in found.values())
    assert all(lens.is_harmful for lens in found.values())


def test_what_else_is_wrong_is_no_lens() -> None:
    plan = lab_plan(picture_rate=1.0)
    (robot,), cameras = plan.robots.values(), plan.cameras
    late = {name: replace(camera, time_offset_s=0.1) for name, camera in cameras.items()}
    for other in (
        plan,
        replace(plan, robots={"r1": replace(robot, scales=(0.1, 0.0))}),
        replace(plan, robots={"r1": replace(robot, scales=(0.05, -0.05))}),
        replace(plan, stated=0.05),
        replace(plan, cameras=late),
    ):
        session = make_session(other)
        assert not pushed(session.inputs, session.messages).arrivals.lenses


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
