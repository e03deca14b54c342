"""What lifts and robots that carry one target leave open, by who knows the truth."""

import pytest
from msgspec.structs import replace

from benchmarks.study.decidable import left_open
from benchmarks.study.oracle import known_to_oracle
from benchmarks.study.session import StudySession, simulated_session


def test_cameras_that_were_met_on_one_side_of_a_lift_alone_are_open(
    kidnapped: StudySession,
) -> None:
    data, oracle = known_to_oracle(kidnapped.inputs, kidnapped.simulated)
    assert left_open(data, oracle) == {"c3", "c5", "c6"}


def test_nothing_is_open_without_a_lift(kidnapped: StudySession) -> None:
    data, oracle = known_to_oracle(kidnapped.inputs, kidnapped.simulated)
    assert left_open(data, replace(oracle, lifted_ns={})) == set()


def test_nothing_is_open_where_every_camera_was_met_before_and_after(
    kidnapped_known: StudySession,
) -> None:
    data, oracle = known_to_oracle(kidnapped_known.inputs, kidnapped_known.simulated)
    assert left_open(data, oracle) == set()


@pytest.mark.parametrize(
    ("situation", "seed", "expected"),
    [
        # Both drive straight on as c5 sees one and c6 the other, and nothing else sees either: the
        # two may be exchanged. With another seed one of the two turns before its camera.
        ("robots_alike", 1, {"c5", "c6"}),
        ("robots_alike", 0, set[str]()),
        # What other cameras drift by as these two hang elsewhere leaves none of them open.
        ("robots_alike", 8, {"c5", "c6"}),
        ("two_robots", 0, set[str]()),
    ],
)
def test_cameras_are_open_where_robots_may_be_exchanged(
    situation: str, seed: int, expected: set[str]
) -> None:
    session = simulated_session(situation, seed)
    data, oracle = known_to_oracle(session.inputs, session.simulated)
    assert left_open(data, oracle) == expected
