"""A site under fire: all that a week in the field may bring at drawn moments, and the network at
the end is the undisturbed one's. A minute here; `python -m benchmarks.endurance.fire` takes ten."""

from collections.abc import Callable
from pathlib import Path

import pytest
from support.site.faulty_run import assert_site_stays_undisturbed


@pytest.mark.timeout(300)
def test_minute_under_fire_ends_in_the_undisturbed_network(
    tmp_path: Path, free_port: Callable[[], int]
) -> None:
    assert_site_stays_undisturbed(tmp_path, free_port(), seconds=45.0, seed=9)
