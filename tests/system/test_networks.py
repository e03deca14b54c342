"""A secured site across networks that lose, delay and break, in namespaces made by the test."""

import pytest

from benchmarks.network.bad_links import (
    BAD,
    DATAGRAMS,
    FAIR,
    WITH_VIEWER,
    Key,
    Scenario,
    coming_late,
    flapping,
    killing,
    run,
)
from benchmarks.network.impairment import Namespace, NoNamespacesError


@pytest.fixture(autouse=True)
def namespaces() -> None:
    """Skip where this user or kernel makes none."""
    try:
        space = Namespace()
        space.tun("tptry")
    except (NoNamespacesError, FileNotFoundError) as reason:
        pytest.skip(f"no network namespaces here: {reason}")
    space.close()


def assert_recovered(key: Key, *, at_least: int) -> None:
    """Nothing twice, in order, what is missing was counted, and it went on after the break."""
    assert key.twice == 0
    assert key.numbers == sorted(key.numbers)
    assert key.uncounted == 0
    assert key.sent >= at_least
    assert key.last == key.sent - 1


def test_router_dies_on_a_network_that_loses_and_delays() -> None:
    """What its break held up comes, or is counted; on a machine that is very busy it is at times
    not asked for, since the first new sample is quicker than the news of who has the old ones."""
    found = run(Scenario(BAD, seconds=12.0, action=killing(2.0, 5.0), protocols=DATAGRAMS))
    assert_recovered(found["odom"], at_least=500)
    assert_recovered(found["sightings"], at_least=100)
    assert found["correction"].last >= found["correction"].sent - 10
    assert found["correction"].twice == 0
    assert found["correction"].numbers == sorted(found["correction"].numbers)


def test_links_flap_while_somebody_looks_at_pictures() -> None:
    found = run(Scenario(FAIR, seconds=13.0, action=flapping(2), roles=WITH_VIEWER))
    assert_recovered(found["odom"], at_least=500)
    assert_recovered(found["sightings"], at_least=100)
    assert (found["odom"].lost, found["sightings"].lost) == (0, 0)
    assert found["image"].numbers


def test_everyone_waits_for_a_router_that_comes_late() -> None:
    found = run(Scenario(FAIR, seconds=6.0, action=coming_late(3.0), late_router=True))
    for name, at_least in (("odom", 150), ("sightings", 30)):
        key = found[name]
        assert key.twice == 0
        assert key.sent >= at_least
        assert key.numbers == list(range(key.sent))
    assert found["correction"].numbers
