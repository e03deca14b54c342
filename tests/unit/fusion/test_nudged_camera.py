"""A camera that noticed itself that it was turned: what it sees makes no correction until robots
have shown where it is, and nothing else suffers."""

from collections.abc import Sequence

import numpy as np
import pytest
from msgspec.structs import replace
from msgspec.structs import replace as replace_struct
from support.fusion.drives import EPOCH_NS, Session, lab_plan, make_session
from support.fusion.solvers import SlowSolver

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.messages import (
    Diagnostics,
    DiagnosticStatus,
    Message,
    PoseEstimate,
    Sightings,
)
from trigpoint.contract.nudge import NUDGED, Nudge
from trigpoint.fusion.pipeline import Inputs, Pipeline

SECONDS, NUDGED_S, TOLD_S = 50.0, 25.2, 27.3
TURN = np.array([0.0, 0.0, 0.0, 0.0, np.radians(0.3), 0.0])
PLANE = [0, 1, 5]
Messages = Sequence[tuple[str, Message]]


def at_ns(seconds: float) -> int:
    return EPOCH_NS + to_ns(seconds)


def telling(nudge: Nudge, stamp_ns: int) -> Diagnostics:
    """What a camera's agent says once a second."""
    status = DiagnosticStatus(0, f"edge/{nudge.camera}", "", "host", {NUDGED: nudge.value})
    return Diagnostics(stamp_ns, (status,))


@pytest.fixture(scope="module")
def session() -> Session:
    """c2 is turned by 0.3 degrees while the robot is before it; the truth is where it is since."""
    plan = lab_plan(seconds=SECONDS, seed=4)
    old = plan.cameras["c2"]
    new = replace(old, map_from_camera=old.map_from_camera.moved(TURN))
    before = make_session(plan)
    after = make_session(replace(plan, cameras=plan.cameras | {"c2": new}))
    moved_ns = at_ns(NUDGED_S)
    kept = [(n, m) for n, m in before.messages if n != "c2" or m.stamp_ns < moved_ns]
    kept += [(n, m) for n, m in after.messages if n == "c2" and m.stamp_ns >= moved_ns]
    kept.sort(key=lambda item: (item[1].stamp_ns, isinstance(item[1], Sightings)))
    return replace(after, messages=tuple(kept))


def with_nudge(messages: Messages, *, told_s: float = TOLD_S) -> list[tuple[str, Message]]:
    """The agent tells it every second from `told_s` on, as it does on the bus."""
    nudge = Nudge("c2", at_ns(NUDGED_S - 0.7), at_ns(NUDGED_S + 0.3))
    found: list[tuple[str, Message]] = []
    due_ns = at_ns(told_s)
    for node, message in messages:
        assert not isinstance(message, Diagnostics)
        if (stamp_ns := getattr(message, "stamp_ns")) >= due_ns:  # noqa: B009
            found.append(("", telling(nudge, stamp_ns)))
            due_ns += to_ns(1.0)
        found.append((node, message))
    return found


def corrections(pipeline: Pipeline, messages: Messages) -> dict[int, PoseEstimate]:
    """By stamp, the corrections that are made while messages come."""
    found = {}
    for node, message in messages:
        pipeline.push(node, message)
        if isinstance(message, Diagnostics):
            continue
        for output in pipeline.advance(getattr(message, "stamp_ns") + to_ns(0.02)):  # noqa: B009
            if output.topic is topics.CORRECTION:
                assert isinstance(output.message, PoseEstimate)
                found[output.message.stamp_ns] = output.message
    return found


def by_camera(session: Session, found: dict[int, PoseEstimate], camera: str) -> list[int]:
    """The stamps of corrections that only this camera's pictures can have made."""
    mine = {m.stamp_ns for n, m in session.messages if n == camera and isinstance(m, Sightings)}
    others = {
        m.stamp_ns
        for n, m in session.messages
        if n != camera and isinstance(m, Sightings) and m.faces
    }
    return [stamp for stamp in found if stamp in mine - others]


def normalised(session: Session, message: PoseEstimate) -> float:
    error = message.pose.difference(session.map_from_base("r1", message.stamp_ns))[PLANE]
    covariance = message.covariance[np.ix_(PLANE, PLANE)]
    return float(error @ np.linalg.solve(covariance, error)) / 3


def estimated_by(inputs: Inputs, estimator: str) -> Inputs:
    site = inputs.site
    fusion = replace_struct(site.fusion, estimator=estimator)
    return replace(inputs, site=replace_struct(site, fusion=fusion))


@pytest.mark.parametrize("how", ["solver", "slow solver", "smoother", "ekf"])
def test_nudged_camera_makes_no_correction_until_it_is_located_again(
    session: Session, how: str
) -> None:
    inputs = estimated_by(session.inputs, "ekf" if how == "ekf" else "smoother")
    calls = {"solver": 0, "slow solver": 150}.get(how)
    solver = None if calls is None else SlowSolver(inputs, calls=calls)
    pipeline = Pipeline(inputs, solver=solver)
    messages = with_nudge(session.messages)
    told = next(i for i, (_, m) in enumerate(messages) if isinstance(m, Diagnostics))
    corrections(pipeline, messages[: told + 1])
    assert set(pipeline.nudges.open) == {"c2"}
    silent: dict[int, PoseEstimate] = {}
    rest = iter(messages[told + 1 :])
    while pipeline.nudges.open:
        silent |= corrections(pipeline, [next(rest)])
    assert not by_camera(session, silent, "c2")
    again = corrections(pipeline, list(rest))
    mine = by_camera(session, again, "c2")
    assert len(mine) > 5
    assert np.mean([normalised(session, again[stamp]) for stamp in mine]) < 2.0
    assert len(by_camera(session, silent | again, "c1")) > 5
    assert pipeline.left_out["camera_nudged"] == 1


def test_nudged_camera_keeps_its_old_place_and_spoils_no_other(session: Session) -> None:
    pipeline = Pipeline(session.inputs, is_live=False)
    corrections(pipeline, with_nudge(session.messages))
    pipeline.finish()
    network = pipeline.results().network
    assert network.located == list(session.plan.cameras)
    assert len(network.cameras["c2"].earlier) == 1
    error = session.error(pipeline.results())
    assert error.nees is not None
    assert error.nees < 2.5


def test_untold_turn_is_averaged_away(session: Session) -> None:
    """What sightings alone make of it: too little to be seen as a move."""
    pipeline = Pipeline(session.inputs, is_live=False)
    corrections(pipeline, session.messages)
    pipeline.finish()
    assert not pipeline.results().network.cameras["c2"].earlier


@pytest.mark.parametrize("is_live", [False, True], ids=["offline", "with a solver"])
def test_camera_that_was_nudged_and_saw_no_robot_since_is_undetermined(
    session: Session, is_live: bool
) -> None:
    moved_ns = at_ns(NUDGED_S)
    before = [(n, m) for n, m in session.messages if n != "c2" or m.stamp_ns < moved_ns]
    solver = SlowSolver(session.inputs) if is_live else None
    pipeline = Pipeline(session.inputs, is_live=is_live, solver=solver)
    corrections(pipeline, with_nudge(before))
    pipeline.finish()
    pipeline.advance()
    network = pipeline.results().network
    record = network.cameras["c2"]
    assert network.located == [name for name in session.plan.cameras if name != "c2"]
    assert "turned or shifted" in record.undetermined[0]
    assert len(record.earlier) == 1
    assert set(pipeline.nudges.open) == {"c2"}


def test_nudge_before_the_map_began_does_not_concern_it(session: Session) -> None:
    pipeline = Pipeline(session.inputs, is_live=False)
    corrections(pipeline, session.messages[:200])
    nudge = Nudge("c2", at_ns(-9.0), at_ns(-8.0))
    assert not pipeline.push("", telling(nudge, at_ns(20.0)))
    assert not pipeline.nudges.open


def test_nudge_that_goes_on_is_one(session: Session) -> None:
    pipeline = Pipeline(session.inputs, is_live=False)
    corrections(pipeline, session.messages[:10])
    for since_s in (26.0, 27.0, 27.0):
        nudge = Nudge("c2", at_ns(25.0), at_ns(since_s))
        pipeline.push("", telling(nudge, at_ns(since_s + 1)))
    (move,) = pipeline._data.told
    assert move.since_ns == at_ns(27.0)


def test_nudge_is_kept_once(session: Session) -> None:
    pipeline = Pipeline(session.inputs, is_live=False)
    corrections(pipeline, session.messages[:10])
    told = telling(Nudge("c2", at_ns(25.0), at_ns(26.0)), at_ns(27.0))
    assert pipeline.push("", told)
    assert not pipeline.push("", told)


def test_camera_of_another_site_does_not_concern_it(session: Session) -> None:
    pipeline = Pipeline(session.inputs, is_live=False)
    assert not pipeline.push("", telling(Nudge("c9", at_ns(25.0), at_ns(26.0)), at_ns(27.0)))
    assert not pipeline.nudges.open
