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
