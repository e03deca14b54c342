"""What a lift leaves open, by who knows when it was."""

from msgspec.structs import replace

from benchmarks.study.decidable_lifts import left_open
from benchmarks.study.oracle import known_to_oracle
from benchmarks.study.session import StudySession


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
