"""Puts the pipeline's outputs on their keys."""

from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract import cdr, topics
from trigpoint.node.health import Health
from trigpoint.security.authenticator import Signer
from trigpoint.site.config import Site

from .delays import Delays
from .output import CameraAccuracy, Output


class Publishing:
    """The publishers of a site's outputs. Used by one thread. `accuracy`: of what was sent."""

    def __init__(
        self, bus: Bus, site: Site, health: Health, signer: Signer, delays: Delays
    ) -> None:
        self._bus, self._site, self._health, self._signer = bus, site, health, signer
        self._delays = delays
        self._publishers: dict[str, Publisher] = {}
        self.accuracy = CameraAccuracy(list(site.cameras))

    def send_all(self, outputs: list[Output]) -> None:
        """Send all; a robot waits for its correction, nobody for the rest."""
        for output in sorted(outputs, key=lambda o: o.topic is not topics.CORRECTION):
            self._send(output)

    def _send(self, output: Output) -> None:
        key = output.topic.key(self._site.name, output.node)
        if key not in self._publishers:
            self._publishers[key] = self._bus.publisher(output.topic, key)
        payload, attachment = cdr.encode(output.message), output.attachment
        if output.topic is topics.CORRECTION:
            attachment = self._signer.sign(key, payload, attachment)
        self._publishers[key].put(payload, attachment=attachment)
        self._health.count(f"sent {key}")
        if output.observation is not None:
            self._delays.corrected(output.observation)
        if words := self.accuracy.words_after(output):
            self._health.describe("cameras", words)
