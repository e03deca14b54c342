"""A site under fire: all that a week in the field may bring at drawn moments, and the network at
the end is the undisturbed one's. Half a minute, or ten."""

from collections.abc import Callable
from pathlib import Path

import pytest
from support.site.faulty_run import assert_site_stays_undisturbed


@pytest.mark.parametrize(
    ("seconds", "seed"),
    [
        pytest.param(24.0, 9, marks=pytest.mark.timeout(300)),
        pytest.param(600.0, 1, marks=[pytest.mark.long, pytest.mark.timeout(1800)]),
    ],
)
def test_time_under_fire_ends_in_the_undisturbed_network(
    tmp_path: Path, free_port: Callable[[], int], seconds: float, seed: int
) -> None:
    assert_site_stays_undisturbed(tmp_path, free_port(), seconds=seconds, seed=seed)
