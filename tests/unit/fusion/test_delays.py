"""How long sightings take to fusion, and in it."""

import numpy as np

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.bus.bus import Sample
from trigpoint.contract.messages import FaceSighting, Sightings
from trigpoint.fusion.delays import Delays
from trigpoint.fusion.model.observations import Observation
from trigpoint.node.health import Health

PERIOD_NS = to_ns(0.1)


def taken(delays: Delays, clock: ManualClock, camera: str, stamp_ns: int) -> None:
    """Sightings, sent 30 ms after their stamp and here another 2 ms later."""
    face = FaceSighting("", 0, np.zeros(0), np.zeros((0, 2)), 0.1)
    sent_ns = stamp_ns + to_ns(0.030)
    clock.advance((sent_ns + to_ns(0.002) - clock.now_ns()) / 1e9)
    sample = Sample(f"lab/camera/{camera}/sightings", b"", "", sent_ns, clock.now_ns())
    delays.came(sample, Sightings(stamp_ns, f"{camera}/optical", 640, 480, (face,)))


def test_a_correction_is_timed_from_the_coming_of_its_own_picture() -> None:
    clock = ManualClock()
    health = Health(clock)
    delays = Delays(health, clock)
    for picture in range(3):
        taken(delays, clock, "c1", picture * PERIOD_NS)
    taken(delays, clock, "c2", 2 * PERIOD_NS + to_ns(0.004))
    # Of the second picture; the robot was in its lower half, which is exposed 15 ms later.
    delays.corrected(Observation("c1", "r1", PERIOD_NS + to_ns(0.015), (), None))
    values = health.report().values
    assert values["sighting_transit.seconds"] == "0.008000 0 4"
    assert values["fusion.seconds"] == "0.104000 0 0 0 0 0 0 0 1"
