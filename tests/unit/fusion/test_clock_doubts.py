"""A camera or a robot whose clock is off, as it says itself: what cameras see by such a clock makes
no correction and moves nothing in the map, and is used again when the clock is right."""

from collections.abc import Sequence

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Session, lab_plan, make_session

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.clock_doubt import CLOCK_OFF_BY, CLOCK_SET_BY
from trigpoint.contract.messages import (
    CameraInfo,
    Diagnostics,
    DiagnosticStatus,
    Message,
    Sightings,
)
from trigpoint.contract.nudge import NUDGED, Nudge
from trigpoint.fusion.diagnostics import Diagnostics as InputDiagnostics
from trigpoint.fusion.intake.admission import Admission
from trigpoint.fusion.intake.clock_doubts import ClockDoubts
from trigpoint.fusion.pipeline import Inputs, Pipeline
from trigpoint.fusion.replaying import Replay
from trigpoint.geometry import Pose

OFF_S = 0.3
Messages = Sequence[tuple[str, Message]]


def saying(stamp_ns: int, **off_by: float) -> Diagnostics:
    """What nodes say once a second; `off_by`: of cameras and robots, s."""
    statuses = [
        DiagnosticStatus(
            0,
            f"{'robot' if name.startswith('r') else 'edge'}/{name}",
            "running",
            "host",
            {CLOCK_OFF_BY: f"{seconds:+.3f}"} if seconds else {},
        )
        for name, seconds in off_by.items()
    ]
    return Diagnostics(stamp_ns, tuple(statuses))


def shifted(messages: Messages, camera: str, seconds: float, until_s: float) -> Messages:
    """As they come where a camera's clock is ahead by so much until a moment."""
    found, until_ns = [], EPOCH_NS + to_ns(until_s)
    for name, message in messages:
        if isinstance(message, Sightings) and name == camera and message.stamp_ns < until_ns:
            message = replace(message, stamp_ns=message.stamp_ns + to_ns(seconds))
        found.append((name, message))
    assert any(new is not old for (_, new), (_, old) in zip(found, messages, strict=True))
    return found


@pytest.fixture(scope="module")
def session() -> Session:
    return make_session(lab_plan(seconds=30.0, seed=5))


def site_doubts(session: Session) -> ClockDoubts:
    return ClockDoubts(session.inputs.site)


def test_camera_beyond_what_is_borne_is_doubted_and_said_until_it_is_right(
    session: Session,
) -> None:
    doubts, limit_s = site_doubts(session), session.inputs.site.bearable_clock_offset_s("c2")
    assert doubts.hear(saying(1, c1=0.9 * limit_s, c2=-OFF_S)) == [
        "camera c2: what it sees makes no corrections and is not learnt from: its clock is 0.300 s "
        "behind fusion's; synchronise the clocks (chrony; trigpoint doctor)"
    ]
    assert set(doubts.open) == {"camera c2"}
    assert not doubts.why("c1", ["r1"])
    assert "0.300 s behind" in doubts.why("c2", ["r1"])
    assert not doubts.hear(saying(2, c2=-OFF_S))  # said once
    assert not doubts.hear(saying(3, c2=0.0))
    assert not doubts.open
    assert not doubts.why("c2", ["r1"])
    assert not doubts.hear(saying(4, c2=OFF_S))  # one event a node, however often it comes and goes
    assert doubts.why("c2", ["r1"])


def test_offset_that_costs_little_is_borne_and_what_is_refused_is_used_once_it_is_borne(
    session: Session,
) -> None:
    doubts, limit_s = site_doubts(session), session.inputs.site.bearable_clock_offset_s("c2")
    refused = []
    for times in (2.9, 3.1, 2.9, 1.1, -1.1, 0.0, 2.9, -3.1):
        doubts.hear(saying(1, c2=times * limit_s))
        refused.append(bool(doubts.why("c2", ["r1"])))
        assert bool(doubts.open) == refused[-1]
    assert refused == [False, True, True, True, True, False, False, True]


def test_node_that_says_nothing_for_five_seconds_is_doubted_no_longer(session: Session) -> None:
    """By the clock of any other that goes on, which may be an hour off, as its own may."""
    for off_s in (OFF_S, 3600.0, -3600.0):
        doubts = site_doubts(session)
        doubts.hear(saying(EPOCH_NS + to_ns(off_s), c2=off_s))
        for at_s in (0.5, 3.0, 5.5):
            doubts.hear(saying(EPOCH_NS + to_ns(at_s), c1=0.0))
            doubts.hear(saying(EPOCH_NS + to_ns(at_s - off_s), r1=0.0))
        assert doubts.why("c2", ["r1"])
        doubts.hear(saying(EPOCH_NS + to_ns(5.6), c1=0.0))
        assert not doubts.why("c2", ["r1"])
        assert not doubts.open


def test_node_that_goes_on_saying_that_its_clock_is_off_is_doubted(session: Session) -> None:
    doubts = site_doubts(session)
    for second in range(20):
        doubts.hear(saying(EPOCH_NS + to_ns(second), c2=OFF_S))
        doubts.hear(saying(EPOCH_NS + to_ns(second + 0.5), c1=0.0))
        assert doubts.why("c2", ["r1"])


def test_one_of_two_robots_with_one_target_whose_clock_is_off_takes_nothing_from_the_other() -> (
    None
):
    """The picture may show the other one; only where the robot is known, no correction comes."""
    session = two_alike()
    pipeline = Pipeline(session.inputs)
    seen = first_seen(session, "c2")
    pipeline.push("", saying(1, r1=OFF_S, r2=0.0))
    assert pipeline.clocks.why("c2", ["r1"])
    assert pipeline.push("c2", seen)
    pipeline.push("", saying(2, r1=OFF_S, r2=-OFF_S))
    assert not pipeline.push("c2", seen)
    why = pipeline.arrivals.unused["c2"]
    assert "robot r1: " in why
    assert "robot r2: " in why
    pipeline.push("", saying(3, r1=0.0, r2=-OFF_S))
    assert pipeline.push("c2", replace(seen, stamp_ns=seen.stamp_ns + 1))
    assert not pipeline.arrivals.unused


def two_alike() -> Session:
    plan = lab_plan(seconds=3.0)
    second = replace(plan.robots["r1"], map_from_odom=Pose.planar(0.0, 2.4, np.pi))
    return make_session(replace(plan, robots=plan.robots | {"r2": second}))


def first_seen(session: Session, camera: str) -> Sightings:
    return next(
        m for n, m in session.messages if n == camera and isinstance(m, Sightings) and m.faces
    )


def test_clock_of_fusion_that_is_off_from_all_others_takes_nothing_away(session: Session) -> None:
    doubts = site_doubts(session)
    assert not doubts.hear(saying(1, r1=OFF_S, c1=OFF_S, c2=OFF_S, c3=OFF_S))
    assert not doubts.why("c1", ["r1"])
    [words] = doubts.hear(saying(2, r1=0.0, c1=0.0, c3=0.0))
    assert words.startswith("camera c2: ")


def test_robot_whose_clock_is_off_is_doubted_beside_every_camera(session: Session) -> None:
    doubts = site_doubts(session)
    [words] = doubts.hear(saying(1, r1=-OFF_S))
    assert words.startswith("robot r1: what cameras see of it makes no corrections")
    assert all(doubts.why(camera, ["r1"]) == words for camera in ("c1", "c2", "c3"))


def test_clock_that_was_set_is_doubted_and_what_says_nonsense_is_not(session: Session) -> None:
    doubts = site_doubts(session)
    values = {"c1": {CLOCK_SET_BY: "+2.000"}, "c2": {CLOCK_OFF_BY: "nan"}, "c3": {CLOCK_OFF_BY: ""}}
    values["c9"] = {CLOCK_OFF_BY: "+1.0"}  # is not of this site
    statuses = tuple(DiagnosticStatus(0, f"edge/{n}", "", "", v) for n, v in values.items())
    [words] = doubts.hear(Diagnostics(1, statuses))
    assert "camera c1" in words
    assert "was set and is not followed yet" in words


@pytest.mark.parametrize("ahead_s", [OFF_S, -OFF_S])
def test_what_a_camera_saw_while_its_clock_was_off_leaves_no_trace(
    session: Session, ahead_s: float
) -> None:
    """As if it had not seen anything until then: the same network, and no correction by it."""
    until_s = 15.0
    right_ns = EPOCH_NS + to_ns(until_s)
    wrong = shifted(session.messages, "c2", ahead_s, until_s)
    told = with_diagnostics(wrong, ahead_s, right_ns)
    without = [
        item
        for item in session.messages
        if not (item[0] == "c2" and isinstance(item[1], Sightings) and item[1].stamp_ns < right_ns)
    ]
    mine, other = Pipeline(session.inputs), Pipeline(session.inputs)
    corrections = fed(mine, told), fed(other, without)
    assert corrections[0] == corrections[1]
    assert mine.left_out["clock_in_doubt"] > 10
    assert mine.left_out["clock_doubted"] == 1
    for name, camera in mine.results().network.cameras.items():
        assert camera.map_from_camera == other.results().network.cameras[name].map_from_camera
    assert any("camera c2: what it sees makes no corrections" in note for note in mine.notes)


def with_diagnostics(messages: Messages, ahead_s: float, right_ns: int) -> Messages:
    """The camera says so from the start, and from a moment on that it is right."""
    before = [i for i, (_, m) in enumerate(messages) if getattr(m, "stamp_ns", 0) < right_ns]
    cut = max(before) + 1
    told = ("", saying(EPOCH_NS, c2=ahead_s)), ("", saying(right_ns, c2=0.0))
    return [told[0], *messages[:cut], told[1], *messages[cut:]]


def fed(pipeline: Pipeline, messages: Messages) -> list[int]:
    """The stamps of the corrections that were made on the way."""
    found = []
    for node, message in messages:
        pipeline.push(node, message)
        found += [o.message for o in pipeline.advance() if o.topic is topics.CORRECTION]
    pipeline.finish()
    return [getattr(each, "stamp_ns") for each in found]  # noqa: B009


def test_what_is_doubted_is_in_the_diagnostics_and_nothing_of_it_is_stored(
    session: Session,
) -> None:
    pipeline, site = Pipeline(session.inputs), session.inputs.site
    diagnostics = InputDiagnostics(site, Admission(site))
    assert not pipeline.push("", saying(1, c2=OFF_S))
    seen = first_seen(session, "c2")
    assert not pipeline.push("c2", seen)
    assert "its clock is 0.300 s ahead" in diagnostics.now(pipeline, 0)["doubted camera c2"]
    pipeline.push("", saying(2, c2=0.0))
    assert pipeline.push("c2", seen)
    assert not diagnostics.now(pipeline, 1)


def test_picture_that_waits_for_a_lens_is_judged_once_when_it_comes(session: Session) -> None:
    lenses = {name: lens for name, lens in session.inputs.lenses.items() if name != "c2"}
    pipeline = Pipeline(Inputs(session.inputs.site, session.inputs.targets, lenses))
    assert pipeline.push("c2", first_seen(session, "c2"))  # and so it is stored
    pipeline.push("", saying(1, c2=OFF_S))
    lens = session.plan.cameras["c2"].lens
    assert pipeline.push("c2", CameraInfo(EPOCH_NS, "c2/optical", lens))
    assert "clock_in_doubt" not in pipeline.left_out
    assert pipeline.waiting == 1


def test_camera_that_was_nudged_and_whose_clock_is_off_has_both_said_under_its_name(
    session: Session,
) -> None:
    pipeline, site = Pipeline(session.inputs), session.inputs.site
    pipeline.push(*session.messages[0])
    assert pipeline.push("", nudged_and_off())
    said = InputDiagnostics(site, Admission(site)).now(pipeline, 0)
    assert list(said) == ["doubted camera c2"]
    assert "was turned or shifted" in said["doubted camera c2"]
    assert "its clock is 0.300 s ahead" in said["doubted camera c2"]


def nudged_and_off() -> Diagnostics:
    nudge = Nudge("c2", EPOCH_NS + to_ns(1.0), EPOCH_NS + to_ns(2.0))
    message = saying(nudge.since_ns, c2=OFF_S)
    [status] = message.statuses
    return replace(
        message, statuses=(replace(status, values=status.values | {NUDGED: nudge.value}),)
    )


def test_nothing_that_was_said_of_clocks_is_left_after_a_restart_but_moves_are(
    session: Session,
) -> None:
    """The message with the move is stored whole, the one that the clock is right again is not."""
    pipeline = Pipeline(session.inputs, is_live=False)
    replay = Replay(pipeline)
    replay.take(*session.messages[0])
    replay.take_moves(nudged_and_off())
    replay.flush()
    pipeline.resumed()
    assert not pipeline.clocks.open
    assert set(pipeline.nudges.open) == {"c2"}
    assert pipeline.push("c2", first_seen(session, "c2"))


def test_what_comes_while_a_checkpoint_is_read_is_stored_as_what_comes_later(
    session: Session,
) -> None:
    pipeline, seen = Pipeline(session.inputs, is_live=False), first_seen(session, "c2")
    assert pipeline.is_to_be_stored("c2", seen)
    assert pipeline.is_to_be_stored("", nudged_and_off())
    assert not pipeline.is_to_be_stored("c2", seen)
    assert not pipeline.is_to_be_stored("", saying(EPOCH_NS, c2=0.0))
    assert pipeline.is_to_be_stored("c2", seen)


def test_camera_that_is_unseen_for_its_clock_says_so(session: Session) -> None:
    pipeline = Pipeline(session.inputs, is_live=False)
    for node, message in [("", saying(EPOCH_NS, c2=OFF_S)), *session.messages]:
        pipeline.push(node, message)
    pipeline.finish()
    camera = pipeline.results().network.cameras["c2"]
    assert camera.status == "unseen"
    assert "its clock is 0.300 s ahead of fusion's" in camera.undetermined[0]
