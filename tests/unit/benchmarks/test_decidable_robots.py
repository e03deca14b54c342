"""What robots that carry one target leave open, by who knows which was where."""

import pytest

from benchmarks.study.decidable_robots import left_open_by_robots
from benchmarks.study.oracle import known_to_oracle
from benchmarks.study.session import simulated_session


@pytest.mark.parametrize(
    ("situation", "seed", "expected"),
    [
        # Both drive straight on as c5 sees one and c6 the other, and nothing else sees either: the
        # two may be exchanged. With another seed one of the two turns before its camera.
        ("robots_alike", 1, {"c5", "c6"}),
        ("robots_alike", 0, set[str]()),
        ("two_robots", 0, set[str]()),
    ],
)
def test_cameras_are_open_where_robots_may_be_exchanged(
    situation: str, seed: int, expected: set[str]
) -> None:
    session = simulated_session(situation, seed)
    data, oracle = known_to_oracle(session.inputs, session.simulated)
    assert left_open_by_robots(data, oracle) == expected
