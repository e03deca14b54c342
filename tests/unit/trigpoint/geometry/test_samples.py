"""Quantiles are numpy's."""

import numpy as np
import pytest

from trigpoint.geometry.samples import median, quantile


@pytest.mark.parametrize("count", [1, 2, 3, 10, 101])
def test_quantiles_are_numpys(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    for share in (0.0, 0.1, 0.5, 0.99, 1.0):
        assert quantile(values, share) == pytest.approx(np.quantile(values, share), abs=1e-12)
    assert median(values) == pytest.approx(np.median(values), abs=1e-12)


@pytest.mark.parametrize(
    "values",
    [
        *([1, 2, np.inf], [1, np.inf], [1, 2, 3, np.inf], [np.inf] * 3, [np.inf] * 4),
        *([-np.inf, 1, 2], [-np.inf, 1], [-np.inf] * 3),
    ],
)
def test_medians_beside_infinite_values_are_numpys(values: list[float]) -> None:
    assert median(values) == np.median(values)


def test_a_quantile_between_a_finite_and_an_infinite_value_is_infinite() -> None:
    values = [1.0, 2.0, np.inf]
    assert [quantile(values, share) for share in (0.0, 0.25, 0.75, 1.0)] == [1, 1.5, np.inf, np.inf]


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_no_values_have_no_quantile(share: float) -> None:
    with pytest.raises(IndexError):
        quantile([], share)
