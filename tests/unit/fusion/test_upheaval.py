"""When a robot was lifted or a camera moved, where it shows only much later."""

import numpy as np
import pytest
from drives import live

from benchmarks.study.measure import measure_of
from benchmarks.study.session import StudySession, simulated_session, worked_out
from trigpoint import topics
from trigpoint.clock import to_ns
from trigpoint.messages import Message, Odometry, PoseEstimate, Sightings

HONEST = 3.0  # eᵀP⁻¹e/6n of two or more cameras


def test_cameras_that_a_lifted_robot_met_on_either_side_of_the_lift_are_not_made_up(
    kidnapped: StudySession,
) -> None:
    pipeline = worked_out(kidnapped)
    results = pipeline.results()
    measure = measure_of(kidnapped, results, 0.0)
    assert measure.located == ["c1", "c2"]
    assert (measure.undetermined, measure.left_open) == ([], ["c3", "c5", "c6"])
    assert measure.honesty is not None
    assert measure.honesty < HONEST
    for name in ("c3", "c5", "c6"):
        (reason,) = results.network.cameras[name].undetermined
        assert "r1 was moved by hand some time between 11.0 s and 47.2 s" in reason
    assert pipeline.left_out["robot_lifted"] == 1


@pytest.mark.parametrize(
    "seed", [0, 14], ids=["one visit after the move", "a glimpse from afar before that"]
)
def test_camera_that_was_moved_is_found_though_nothing_came_after_its_last_visit(
    seed: int,
) -> None:
    session = simulated_session("moved", seed)
    pipeline = worked_out(session)
    measure = measure_of(session, pipeline.results(), 0.0)
    assert measure.earlier == ["c2"]
    assert (measure.wrong, measure.undetermined) == ([], [])
    assert measure.honesty is not None
    assert measure.honesty < HONEST
    assert measure.rejected == 0  # all that it saw belongs to one place or the other
    assert pipeline.left_out["camera_moved"] == 1


def test_robot_that_was_lifted_and_then_met_known_cameras_costs_no_camera_its_place(
    kidnapped_known: StudySession,
) -> None:
    pipeline = worked_out(kidnapped_known)
    measure = measure_of(kidnapped_known, pipeline.results(), 0.0)
    assert measure.located == list(kidnapped_known.inputs.site.cameras)
    assert (measure.wrong, measure.made_up) == ([], [])
    assert measure.honesty is not None
    assert measure.honesty < HONEST
    assert pipeline.left_out["robot_lifted"] == 1


def test_robot_gets_no_wrong_correction_once_a_lift_shows(
    kidnapped: StudySession,
) -> None:
    truth = kidnapped.simulated.truth
    arrivals: list[tuple[int, str, Message]] = []
    for node, message in kidnapped.messages:
        assert isinstance(message, Odometry | Sightings)
        arrivals.append((message.stamp_ns, node, message))
    _, sent = live(kidnapped.inputs, arrivals)
    shows_ns = truth.start_ns + to_ns(47.2)
    errors = []
    for _, output in sent:
        message = output.message
        if output.topic is topics.CORRECTION and isinstance(message, PoseEstimate):
            true = truth.map_from_base("r1", np.array([message.stamp_ns]))[0]
            if message.stamp_ns > shows_ns:
                errors.append(np.abs(message.pose.difference(true)).max())
    assert errors  # it is corrected again once it is known where it is
    assert max(errors) < 0.1
