"""Whether the data decide: what an oracle says of one picture, of a turn, and of a drive."""

import pytest
from support.fusion.drives import (
    CameraPlan,
    Plan,
    RobotPlan,
    Session,
    circle,
    looking_at,
    make_session,
    observed,
    turning,
)

from benchmarks.study.decidable import data_decide, lead_of_truth
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.geometry import Pose
from trigpoint.tools.simulation.sight.targets import target_of

EYE = looking_at((0.3, -1.8, 1.5), (0.2, 0.0, 0.65))


def seen(target: str, way, *, most: int | None = None) -> tuple[Session, DataSet, list[Pose]]:
    """What one camera sees of one robot, and where that truly was."""
    plan = Plan({"c1": CameraPlan(EYE)}, {"r1": RobotPlan(way, target_of(target))}, seconds=4.0)
    session = make_session(plan)
    data = observed(session, most=most)
    places = [session.map_from_base("r1", e.observation.stamp_ns) for e in data.entries]
    return session, data, places


@pytest.mark.parametrize(
    ("target", "way", "most", "decides"),
    [
        ("checkerboard", circle(), None, True),
        ("checkerboard", circle(), 1, False),
        ("checkerboard", turning(), None, False),
        ("charuco", circle(), 1, True),
    ],
    ids=["a drive", "one picture", "a turn on the spot", "one picture of marked faces"],
)
def test_oracle_says_whether_the_data_decide(
    target: str, way, most: int | None, decides: bool
) -> None:
    _, data, places = seen(target, way, most=most)
    assert data.entries
    assert data_decide(data, "c1", EYE, places) is decides
    assert all(entry.map_from_base is None for entry in data.entries)  # it leaves the data alone


def test_lead_of_one_picture_of_look_alikes_is_none() -> None:
    _, data, places = seen("checkerboard", circle(), most=1)
    assert abs(lead_of_truth(data, "c1", EYE, places)) < DECISIVE
