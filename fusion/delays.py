"""How long sightings take to fusion, and there until their corrections are sent."""

from collections import defaultdict, deque

from trigpoint.base.clock import Clock, to_seconds
from trigpoint.bus.bus import Sample
from trigpoint.contract.messages import Sightings
from trigpoint.contract.topics import node_of
from trigpoint.node.health import Health

from .model.observations import Observation

_REMEMBERED = 128
"""Sightings of a camera: some seconds of them, as none that is older makes a correction."""


class Delays:
    """Counted in a node's health. Used by one thread at a time."""

    def __init__(self, health: Health, clock: Clock) -> None:
        self._health, self._clock = health, clock
        # By camera: the stamps of sightings, and when they came.
        self._came: defaultdict[str, deque[tuple[int, int]]] = defaultdict(
            lambda: deque(maxlen=_REMEMBERED)
        )

    def came(self, sample: Sample, sightings: Sightings) -> None:
        """Note that sightings came."""
        transit_ns = sample.received_ns - sample.published_ns
        self._health.observe("sighting_transit", to_seconds(transit_ns))
        if sightings.faces:
            arrival = sightings.stamp_ns, sample.received_ns
            self._came[node_of(sample.key)].append(arrival)

    def corrected(self, observation: Observation) -> None:
        """Note that the correction by an observation was sent. Its stamp is its corners', which a
        rolling shutter moves from its picture's, but never nearer to another picture's."""
        came = self._came[observation.camera]
        if came:
            _, came_ns = min(came, key=lambda one: abs(one[0] - observation.stamp_ns))
            self._health.observe("fusion", to_seconds(self._clock.now_ns() - came_ns))
