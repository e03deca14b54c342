"""Histograms of durations, and their text in diagnostics."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trigpoint.contract.durations import BOUNDS_S, Durations


def test_what_takes_just_as_long_as_a_bound_is_within_it() -> None:
    durations = Durations()
    for seconds in (0.0004, 0.001, 0.0011, 400.0):
        durations.add(seconds)
    assert durations.counts == [2, 1, *[0] * (len(BOUNDS_S) - 2), 1]
    assert durations.sum_s == pytest.approx(400.0025)


def test_what_ended_before_it_began_took_no_time() -> None:
    durations = Durations()
    durations.add(-0.2)
    assert (durations.text, durations.counts[0]) == ("0.000000 1", 1)


@given(st.lists(st.floats(0.0, 1000.0)))
def test_text_is_read_back(seconds: list[float]) -> None:
    durations = Durations()
    for each in seconds:
        durations.add(each)
    found = Durations.of(durations.text)
    assert found.counts == durations.counts
    assert found.sum_s == pytest.approx(durations.sum_s, abs=1e-6)


@pytest.mark.parametrize("text", ["", "fast", "1.0 2.5", "1.0 -1", "nan 1", "1.0" + 19 * " 1"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of several functions
        Durations.of(text)
