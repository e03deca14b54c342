"""Listens to a site for the soak run: `python -m benchmarks.endurance.watch SITE`, as an operator.

Twice a second one JSON line: of every key that was heard, how many came, the time of the last (on
the monotonic clock) and the latencies from its stamp (exposure, or odometry reading) to here in
seconds; what each node says that it lost, and which maps fusion said it has, in order. Ends when
standard input does.
"""

import itertools
import json
import sys
import threading
import time
from pathlib import Path

from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bus, Subscription
from trigpoint.contract import topics
from trigpoint.contract.cdr import decode
from trigpoint.contract.messages import Odometry, PoseEstimate, Sightings
from trigpoint.site.config import load_site
from trigpoint.tools.site.status import statuses_in
from trigpoint.zenoh import open_bus

_PERIOD_S = 0.5
_TAKE_S = 0.05
_ASK_EVERY = 4
_ANSWER_S = 0.5
HEARD = (topics.SIGHTINGS, topics.ODOMETRY, topics.CORRECTION, topics.ROBOT_POSE)


class Ear:
    """Listens to one key's messages; read by another thread."""

    def __init__(self, topic: topics.Topic, subscription: Subscription) -> None:
        self._topic, self._subscription = topic, subscription
        self._lock = threading.Lock()
        self._count, self._last_s, self._latencies = 0, 0.0, list[float]()

    def run(self, stopping: threading.Event) -> None:
        while not stopping.is_set():
            sample = self._subscription.take(_TAKE_S)
            if sample is None:
                continue
            try:
                message = decode(self._topic.type_name, sample.payload)
            except MessageError:
                continue  # of the flood
            assert isinstance(message, Sightings | Odometry | PoseEstimate)
            late_s = (sample.received_ns - message.stamp_ns) / 1e9
            with self._lock:
                self._count += 1
                self._last_s = time.monotonic()
                self._latencies.append(round(late_s, 4))

    def told(self) -> dict[str, object]:
        with self._lock:
            late, self._latencies = self._latencies, []
            return {"count": self._count, "last": self._last_s, "latencies": late}


def main() -> None:
    site = load_site(Path(sys.argv[1]))
    stopping = threading.Event()
    with open_bus(site) as bus:
        ears = {t.name: Ear(t, bus.subscribe(t, t.expression(site.name))) for t in HEARD}
        diagnostics = bus.subscribe(topics.DIAGNOSTICS, topics.DIAGNOSTICS.key(site.name))
        threads = [threading.Thread(target=ear.run, args=(stopping,)) for ear in ears.values()]
        threads.append(threading.Thread(target=lambda: (sys.stdin.read(), stopping.set())))
        for thread in threads:
            thread.start()
        losses: dict[str, dict[str, int]] = {}
        maps: list[str] = []
        for number in itertools.count():
            if stopping.wait(_PERIOD_S):
                break
            _hear(diagnostics, losses)
            if number % _ASK_EVERY == 0:
                maps += [map_id for map_id in _maps(bus, site.name) if [map_id] != maps[-1:]]
            row = {"t": time.monotonic(), "losses": losses, "maps": maps}
            row["heard"] = {name: ear.told() for name, ear in ears.items()}
            print(json.dumps(row), flush=True)
        for thread in threads:
            thread.join()


def _maps(bus: Bus, site: str) -> list[str]:
    """What fusion says its map is; nothing while it does not answer."""
    replies = bus.query(topics.command_key(site, "fusion/map"), timeout_s=_ANSWER_S)
    return [json.loads(reply.payload)["map_id"] for reply in replies if not reply.error]


def _hear(diagnostics: Subscription, losses: dict[str, dict[str, int]]) -> None:
    while (sample := diagnostics.take(0.0)) is not None:
        for status in statuses_in(sample):
            lost = {k: int(v) for k, v in status.values.items() if k.endswith(".lost") and v != "0"}
            process = status.values.get("process", "")
            losses[f"{status.name} {process}"] = lost | {"level": int(status.level)}


if __name__ == "__main__":
    main()
