from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from trigpoint.bus import Sample
from trigpoint.bus_queue import SampleQueue


def sample_of(number: int) -> Sample:
    return Sample(str(number), b"", "", number, number)


@given(st.integers(1, 5), st.lists(st.booleans(), max_size=40))
def test_queue_is_a_deque_that_counts_what_falls_out(capacity: int, steps: list[bool]) -> None:
    queue = SampleQueue(capacity, sample_of, lambda: None)
    model: deque[int] = deque(maxlen=capacity)
    pushed = dropped = 0
    for is_push in steps:
        if is_push:
            dropped += len(model) == capacity
            queue.push(pushed)
            model.append(pushed)
            pushed += 1
        else:
            sample = queue.take(0.0)
            assert (sample.published_ns if sample else None) == (model.popleft() if model else None)
        assert (queue.depth, queue.received, queue.dropped) == (len(model), pushed, dropped)


def test_missed_samples_are_counted_as_dropped() -> None:
    queue = SampleQueue(2, sample_of, lambda: None)
    queue.miss(3)
    assert (queue.dropped, queue.received) == (3, 0)


def test_what_waits_can_be_taken_after_closing_but_nothing_comes_in() -> None:
    closed: list[bool] = []
    queue = SampleQueue(2, sample_of, lambda: closed.append(True))
    queue.push(1)
    queue.close()
    queue.close()
    queue.push(2)
    assert closed == [True]
    assert [queue.take(0.0), queue.take(0.0)] == [sample_of(1), None]
