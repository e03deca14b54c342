"""The sending process of the bus benchmark: `python -m benchmarks.network.bus_sender …`."""

import sys
import time

import zenoh

from trigpoint.bus.settings import LOOPBACK, Settings
from trigpoint.contract.topics import TOPICS
from trigpoint.zenoh import ZenohBus, open_session

from .bus_wire import WARM_UP, Wire, open_bare, stamped

_PATIENCE_S = 10.0


def main() -> None:
    """Put by turns on ours and on bare Zenoh, as soon as someone listens to both."""
    wire = Wire.of(sys.argv[1:])
    topic = next(topic for topic in TOPICS if topic.name == wire.topic)
    settings = Settings("peer", listen=(LOOPBACK,), connect=(wire.ours,))
    with (
        ZenohBus(open_session(settings)) as bus,
        open_bare(connect=wire.bare) as session,
        session.declare_publisher(wire.bare_key) as bare,
    ):
        ours = bus.publisher(topic, wire.our_key)
        deadline = time.monotonic() + _PATIENCE_S
        while not (ours.has_listener and _matches(bare)):
            if time.monotonic() > deadline:
                sys.exit("nobody listens")
            time.sleep(0.05)
        time.sleep(0.5)
        for _ in range(WARM_UP + wire.count):
            for put in (ours.put, bare.put):
                put(stamped(time.monotonic_ns(), wire.size))
                time.sleep(wire.pause_s)
        time.sleep(0.5)


def _matches(publisher: zenoh.Publisher) -> bool:
    status = publisher.matching_status
    return bool(getattr(status, "matching", status))  # an object, though its stub says bool


if __name__ == "__main__":
    main()
