import numpy as np
import pytest

from trigpoint.tools.pages.axes import Scale


def test_ends_of_a_scale_lie_at_the_ends_of_its_axis():
    scale = Scale(2.0, 6.0, 100.0, 20.0)
    assert scale([2.0, 4.0, 6.0]) == pytest.approx([100.0, 60.0, 20.0])


def test_logarithmic_scale_gives_equal_room_to_equal_ratios():
    scale = Scale(0.1, 10.0, 0.0, 100.0, is_logarithmic=True)
    assert scale([0.1, 1.0, 10.0]) == pytest.approx([0.0, 50.0, 100.0])


@pytest.mark.parametrize("high", [0.7, 1.0, 3.3, 9.9, 72.1, 480.0])
def test_ticks_are_round_few_and_within(high):
    ticks = Scale(0.0, high, 0.0, 1.0).ticks(5)
    assert 2 <= len(ticks) <= 6
    assert ticks[0] == 0.0
    assert ticks[-1] <= high * (1 + 1e-9)
    digit = ticks[1] / 10 ** np.floor(np.log10(ticks[1]) + 1e-9)
    assert any(digit == pytest.approx(n) for n in (1, 2, 5))


def test_logarithmic_ticks_are_powers_of_ten():
    scale = Scale(0.01, 100.0, 0.0, 1.0, is_logarithmic=True)
    assert scale.ticks() == pytest.approx([0.01, 0.1, 1.0, 10.0, 100.0])
