"""Listens to a site for the soak run: `python -m benchmarks.endurance.watch SITE`, as an operator.

Twice a second one JSON line: of every key that was heard, how many came, the time of the last (on
the monotonic clock) and the latencies from its stamp (exposure, or odometry reading) to here in
seconds; what each node says that it lost, and which maps fusion said it has, in order. Ends when
standard input does.
"""

import itertools
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from msgspec import Struct, field, json

from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bus, Subscription
from trigpoint.contract import topics
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import Odometry, PoseEstimate, Sightings
from trigpoint.site.config import load_site
from trigpoint.tools.site.status import statuses_in
from trigpoint.zenoh import open_bus

_PERIOD_S = 0.5
_ASK_EVERY = 4
_ANSWER_S = 0.5
HEARD = (topics.SIGHTINGS, topics.ODOMETRY, topics.CORRECTION, topics.ROBOT_POSE)


class Heard(Struct):
    """Of one key."""

    count: int = 0
    last: float = 0.0
    latencies: list[float] = field(default_factory=list)

    def take(self, type_name: str, subscription: Subscription) -> None:
        """Take in what came since the last call."""
        self.latencies = []
        while (sample := subscription.take(0.0)) is not None:
            with suppress(MessageError):  # of the flood
                message = decode(type_name, sample.payload)
                assert isinstance(message, Sightings | Odometry | PoseEstimate)
                self.count += 1
                self.last = time.monotonic() - (time.time_ns() - sample.received_ns) / 1e9
                self.latencies.append(round((sample.received_ns - message.stamp_ns) / 1e9, 4))


def main() -> None:
    site = load_site(Path(sys.argv[1]))
    over = threading.Event()
    until = threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True)
    until.start()
    with open_bus(site) as bus:
        ears = {topic: bus.subscribe(topic, topic.expression(site.name)) for topic in HEARD}
        diagnostics = bus.subscribe(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key(site.name))
        heard = {topic.name: Heard() for topic in HEARD}
        losses: dict[str, dict[str, int]] = {}
        maps: list[str] = []
        for number in itertools.count():
            if over.wait(_PERIOD_S):
                break
            _hear(diagnostics, losses)
            if number % _ASK_EVERY == 0:
                maps += [map_id for map_id in _maps(bus, site.name) if [map_id] != maps[-1:]]
            for topic, ear in ears.items():
                heard[topic.name].take(topic.type_name, ear)
            row = {"t": time.monotonic(), "losses": losses, "maps": maps, "heard": heard}
            print(json.encode(row).decode(), flush=True)
    until.join()


def _maps(bus: Bus, site: str) -> list[str]:
    """What fusion says its map is; nothing while it does not answer."""
    replies = bus.query(topics.command_key(site, "fusion/map"), timeout_s=_ANSWER_S)
    return [json.decode(reply.payload)["map_id"] for reply in replies if not reply.error]


def _hear(diagnostics: Subscription, losses: dict[str, dict[str, int]]) -> None:
    while (sample := diagnostics.take(0.0)) is not None:
        for status in statuses_in(sample):
            lost = {k: int(v) for k, v in status.values.items() if k.endswith(".lost") and v != "0"}
            process = status.values.get("process", "")
            losses[f"{status.name} {process}"] = lost | {"level": int(status.level)}


if __name__ == "__main__":
    main()
