"""Asks fusion for its map when corrections want to place the robot anew."""

import json
from uuid import UUID

from trigpoint.base.clock import Clock
from trigpoint.bus.bus import Bus, Reply
from trigpoint.contract.topics import command_key
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse

from .bridge import Bridge

_ASK_EVERY_S = 0.25
# Long for a command that takes a millisecond, short for a node that has to stop.
_ANSWER_S = 1.0


class MapQuestion:
    """A node's thread that asks whenever the bridge needs an answer."""

    def __init__(self, bus: Bus, node: Node, site: str, bridge: Bridge, clock: Clock) -> None:
        self._bus, self._node, self._bridge, self._clock = bus, node, bridge, clock
        self._site = site

    def run(self, pulse: Pulse) -> None:
        """Ask until the node stops."""
        while not self._node.stopping.wait(_ASK_EVERY_S):
            pulse.beat()
            if self._bridge.asks_for_map:
                ask_for_map(self._bus, self._site, self._bridge, self._clock)


def ask_for_map(bus: Bus, site: str, bridge: Bridge, clock: Clock) -> None:
    """Ask once, and pass the answers to the bridge."""
    replies = bus.query(command_key(site, "fusion/map"), timeout_s=_ANSWER_S)
    maps = [found for reply in replies if (found := _map_id(reply)) is not None]
    bridge.hear_map(maps, clock.elapsed_ns())


def _map_id(reply: Reply) -> UUID | None:
    """The map named by a reply; None if it is an error or names none."""
    if reply.error:
        return None
    try:
        return UUID(json.loads(reply.payload)["map_id"])
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
