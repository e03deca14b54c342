from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from trigpoint.bus.bus import Bell, Sample
from trigpoint.bus.queue import SampleQueue


def sample_of(number: int) -> Sample:
    return Sample(str(number), b"", "", number, number)


@given(st.integers(1, 5), st.lists(st.booleans(), max_size=40))
def test_queue_is_a_deque_that_counts_what_falls_out(capacity: int, steps: list[bool]) -> None:
    queue = SampleQueue(capacity, sample_of, lambda: None, key_of=lambda _: "a")
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
    queue = SampleQueue(2, sample_of, lambda: None, key_of=str)
    queue.miss(3)
    assert (queue.dropped, queue.received) == (3, 0)


def test_what_waits_can_be_taken_after_closing_but_nothing_comes_in() -> None:
    closed: list[bool] = []
    queue = SampleQueue(2, sample_of, lambda: closed.append(True), key_of=str)
    queue.push(1)
    queue.close()
    queue.close()
    queue.push(2)
    assert closed == [True]
    assert [queue.take(0.0), queue.take(0.0)] == [sample_of(1), None]


def test_who_sends_much_pushes_out_nobody_and_others_wait_for_one_sample_of_it() -> None:
    queue: SampleQueue[tuple[str, int]] = SampleQueue(
        100,
        lambda item: Sample(item[0], b"", "", item[1], 0),
        lambda: None,
        key_of=lambda item: item[0],
        in_turns=True,
    )
    for number in range(3):
        queue.push(("quiet", number))
    for number in range(1000):
        queue.push(("loud", number))
    taken = [queue.take(0.0) for _ in range(6)]
    assert [sample.key for sample in taken if sample] == ["quiet", "loud"] * 3
    quiet = [sample.published_ns for sample in taken if sample and sample.key == "quiet"]
    assert quiet == [0, 1, 2]
    assert (queue.received, queue.dropped, queue.depth) == (1003, 903, 94)


def test_what_nobody_wants_is_not_kept() -> None:
    queue = SampleQueue(4, sample_of, lambda: None, key_of=str, wanted=lambda key: key == "1")
    for number in range(3):
        queue.push(number)
    assert (queue.received, queue.depth) == (1, 1)


def test_without_turns_samples_are_taken_as_they_came() -> None:
    queue = SampleQueue(9, sample_of, lambda: None, key_of=lambda number: str(number % 3))
    for number in (0, 3, 1, 6, 2, 4):
        queue.push(number)
    assert [queue.take(0.0) for _ in range(6)] == [sample_of(n) for n in (0, 3, 1, 6, 2, 4)]


def test_one_bell_tells_of_every_queue() -> None:
    bell = Bell()
    queues = [
        SampleQueue(2, sample_of, lambda: None, key_of=str, bell=bell, wanted=wanted)
        for wanted in (None, None, lambda key: key != "7")
    ]
    assert not bell.wait(0.0)
    for queue in queues:
        queue.push(1)
        assert bell.wait(0.0)
        assert not bell.wait(0.0)
    queues[2].push(7)  # is not kept
    assert not bell.wait(0.0)
