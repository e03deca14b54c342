from trigpoint.bus.bus import Sample
from trigpoint.bus.latest import MOST_KEYS, LatestSamples


def sample(key: str, number: int) -> Sample:
    return Sample(key, b"", "", number, number)


def latest(closed: list[bool]) -> LatestSamples[Sample]:
    return LatestSamples(
        lambda item: item, lambda: closed.append(True), key_of=lambda item: item.key
    )


def test_of_each_key_the_newest_is_taken_once_and_the_others_are_no_loss() -> None:
    incoming = latest([])
    for number in range(1000):
        incoming.push(sample("loud", number))
    incoming.push(sample("quiet", 7))
    assert incoming.depth == 2
    assert sorted(incoming.take(), key=lambda one: one.key) == [
        sample("loud", 999),
        sample("quiet", 7),
    ]
    assert incoming.take() == []
    incoming.miss(2)
    assert (incoming.received, incoming.dropped) == (1001, 2)


def test_more_keys_than_any_site_has_are_dropped_and_counted() -> None:
    incoming = latest([])
    for number in range(MOST_KEYS + 3):
        incoming.push(sample(str(number), number))
    incoming.push(sample("0", 9))
    assert (incoming.depth, incoming.dropped) == (MOST_KEYS, 3)
    assert incoming.take()[0] == sample("0", 9)


def test_what_comes_after_it_is_closed_is_not_kept() -> None:
    incoming = latest([])
    incoming.push(sample("before", 1))
    incoming.close()
    incoming.push(sample("after", 2))
    assert incoming.received == 1
    assert incoming.take() == [sample("before", 1)]


def test_it_is_withdrawn_once() -> None:
    closed: list[bool] = []
    incoming = latest(closed)
    incoming.close()
    incoming.close()
    assert closed == [True]
