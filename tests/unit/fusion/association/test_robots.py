"""Which of two robots that carry one target a visit is of."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import (
    Plan,
    RobotPlan,
    Way,
    circle,
    lab_cameras,
    make_session,
    observed,
    standing,
)

from trigpoint.base.clock import to_ns
from trigpoint.fusion.association.events import Events, window
from trigpoint.fusion.association.robots import Picture, RobotFit, fits, runs
from trigpoint.fusion.intake import robot_identity
from trigpoint.fusion.intake.robot_identity import RobotIdentification
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.geometry import Pose
from trigpoint.tools.simulation.sight.targets import target_of


def beside(way: Way, *, seconds: float = 8.0) -> DataSet:
    """r1 drives around the lab, r2 elsewhere in its way."""
    target = target_of("charuco")
    other = RobotPlan(way, structs.replace(target, name="other"))
    robots = {
        "r1": RobotPlan(circle(), target),
        "r2": replace(other, map_from_odom=Pose.planar(0.0, 2.4, np.pi)),
    }
    return observed(make_session(Plan(lab_cameras(), robots, seconds=seconds)))


def seen_of(data: DataSet, robot: str) -> list[Picture]:
    """What c1 saw of a robot, as either's."""
    seen = [e.observation for e in data.entries]
    return [
        Picture(one.stamp_ns, tuple(dict.fromkeys(("r1", "r2"), view) for view in one.views))
        for one in seen
        if one.camera == "c1" and one.robot == robot
    ]


def of_first_run(
    data: DataSet, pictures: list[Picture]
) -> tuple[list[Picture], dict[str, RobotFit]]:
    visit = runs(data, "c1", pictures)[0]
    return visit, fits(data, "c1", visit, Events())


@pytest.mark.parametrize("way", [standing(), circle(speed=0.2)], ids=["stands", "is slower"])
def test_robot_that_drove_as_the_pictures_show_is_the_one(way: Way) -> None:
    data = beside(way)
    visit, found = of_first_run(data, seen_of(data, "r1"))
    other = found["r2"].gain if "r2" in found else 0.0
    assert found["r1"].gain > max(other, 0.0) + window()
    assert found["r1"].right(visit) == {
        order: tuple(range(len(picture.faces))) for order, picture in enumerate(visit)
    }


def test_robots_that_drove_alike_explain_it_alike() -> None:
    data = beside(circle())
    _, found = of_first_run(data, seen_of(data, "r1"))
    assert abs(found["r1"].gain - found["r2"].gain) < window()


def test_a_robot_claims_what_its_motion_explains_of_the_visits_other_pictures() -> None:
    data = beside(standing())
    pictures = seen_of(data, "r1")
    _, found = of_first_run(data, pictures[::2])
    others = pictures[1::2]
    strange = {
        robot: replace(view, pixels=view.pixels + 40.0)
        for robot, view in others[1].faces[0].items()
    }
    others[1] = Picture(others[1].stamp_ns, (strange, *others[1].faces[1:]))
    claims = found["r1"].claims(others)
    assert claims.pop(1) == tuple(range(1, len(others[1].faces)))
    assert len(claims) > 3
    assert all(faces == tuple(range(len(others[k].faces))) for k, faces in claims.items())


def test_sightings_of_something_else_are_no_robots() -> None:
    data = beside(standing())
    pictures = seen_of(data, "r1")
    strange = pictures[2]
    shifted = tuple(
        {robot: replace(view, pixels=view.pixels + 40.0) for robot, view in face.items()}
        for face in strange.faces
    )
    pictures[2] = Picture(strange.stamp_ns, shifted)
    visit, found = of_first_run(data, pictures)
    right = found["r1"].right(visit)
    assert right[2] == ()
    assert all(right[order] for order in right if order != 2)


def test_runs_end_where_nobody_was_seen_for_long() -> None:
    data = beside(circle(), seconds=45.0)
    pictures = seen_of(data, "r1")
    early = pictures[:3]
    late = [p for p in pictures if p.stamp_ns > early[-1].stamp_ns + to_ns(31.0)]
    assert late
    assert runs(data, "c1", [*early, *late]) == [early, late]


def test_once_the_budget_is_spent_no_robot_is_told_and_it_is_said() -> None:
    data = beside(circle())
    pictures = seen_of(data, "r1")
    identification = RobotIdentification(data)
    identification._budget.spent = np.inf
    for picture in pictures:
        identification.add("c1", picture.stamp_ns, picture.faces)
    assert not identification.ready(is_end=True)
    assert identification.untold == len(pictures) > 0
    assert "not decided in time" in identification.problem


def identified(
    data: DataSet, pictures: list[Picture], monkeypatch: pytest.MonkeyPatch, share: float
) -> tuple[RobotIdentification, list[str]]:
    """The robots that are told with this share of a session's budget."""
    monkeypatch.setattr(robot_identity, "ALIKE_SHARE", share)
    identification = RobotIdentification(data)
    for picture in pictures:
        identification.add("c1", picture.stamp_ns, picture.faces)
    return identification, [seen.robot for seen in identification.ready(is_end=True)]


def test_however_little_may_be_looked_at_no_robot_is_taken_for_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A robot that nothing is held against, since the budget ends before the other, is not told."""
    data = beside(standing())
    pictures = seen_of(data, "r1")
    told_by = {}
    for share in [0.0, *np.geomspace(1e-3, 0.1, 12).tolist()]:
        identification, robots = identified(data, pictures, monkeypatch, share)
        assert set(robots) <= {"r1"}
        assert identification.undecided == (frozenset() if robots else {"c1"})
        told_by[share] = len(robots)
    assert told_by[0.0] == 0
    assert told_by[max(told_by)] == len(pictures)
