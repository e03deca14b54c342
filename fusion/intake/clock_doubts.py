"""Cameras and robots whose clocks cannot be relied on, as they say themselves.

A robot that is seen at a moment by a camera's clock is placed by its odometry of that moment by its
own; so what counts is how far the two are apart. Fusion's clock, by which both say it, may be the
one that is off: where all say so alike, nothing is doubted. Whoever says nothing of its clock (a
program that does not ask fusion for its time, too) counts as one that agrees with fusion's.
"""

from collections.abc import Iterable
from itertools import product

from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.contract.clock_doubt import CLOCK_SET_BY, REFUSED_FROM, ahead_s
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.site.config import Site

_REMEMBERED_NS = to_ns(5.0)
"""For how long what a node said of its clock holds; it says it every second."""


class _Clock(Struct, frozen=True):
    """What a node says of its clock: by how much it is ahead of fusion's, 0 where that is borne,
    and whether it was set and is not followed yet."""

    ahead_s: float = 0.0
    is_set: bool = False


class ClockDoubts:
    """Whose clocks are in doubt. `open`: what is to be said of each such camera or robot."""

    def __init__(self, site: Site) -> None:
        self._known = {f"edge/{name}": f"camera {name}" for name in site.cameras}
        self._known |= {f"robot/{name}": f"robot {name}" for name in site.robots}
        self._borne_s = {name: site.bearable_clock_offset_s(name) for name in site.cameras}
        self._pairs = list(product(site.cameras, site.robots))
        self._clocks: dict[str, _Clock] = {}  # those that are not right
        self._since_ns: dict[str, dict[str, int]] = {}  # of each, when others first spoke after it
        self._apart = set[tuple[str, str]]()
        self._told = set[str]()
        self.open: dict[str, str] = {}

    def hear(self, message: Diagnostics) -> list[str]:
        """Take what nodes say of themselves; what is to be said of those in doubt for the first
        time."""
        before = dict(self._clocks)
        for status in message.statuses:
            if status.name in self._known:
                self._take(self._known[status.name], status, message.stamp_ns)
        if self._clocks == before:
            return []
        self._apart = {pair for pair in self._pairs if self._are_apart(*pair)}
        doubted = {node for pair in self._pairs for node in self._doubted_of(*pair)}
        self.open = {node: self._words(node) for node in sorted(doubted)}
        new = [node for node in self.open if node not in self._told]
        self._told.update(new)
        return [self.open[node] for node in new]

    def _take(self, node: str, status: DiagnosticStatus, stamp_ns: int) -> None:
        """Take what a node says, and forget who said nothing for as long as this one has been
        speaking since, by its own clock."""
        clock = _Clock(ahead_s(status), CLOCK_SET_BY in status.values)
        self._clocks.pop(node, None)
        if clock != _Clock():
            self._clocks[node], self._since_ns[node] = clock, {}
        for other in list(self._clocks):
            if stamp_ns - self._since_ns[other].setdefault(node, stamp_ns) > _REMEMBERED_NS:
                del self._clocks[other]

    def why(self, camera: str, robots: Iterable[str]) -> str:
        """Why what a camera sees of one of these robots is not to be used, whichever it is; ""
        where it is."""
        doubted = [self._doubted_of(camera, robot) for robot in robots] if self._clocks else []
        if not all(doubted):
            return ""
        return "; ".join(self.open[node] for node in sorted(set[str]().union(*doubted)))

    def _are_apart(self, camera: str, robot: str) -> bool:
        ahead_s, other_s = (
            self._clocks.get(node, _Clock()).ahead_s for node in _nodes(camera, robot)
        )
        times = 1.0 if (camera, robot) in self._apart else REFUSED_FROM
        return abs(ahead_s - other_s) > times * self._borne_s[camera]

    def _doubted_of(self, camera: str, robot: str) -> set[str]:
        """Which of the two say of themselves why they do not go together."""
        said = {node: self._clocks[node] for node in _nodes(camera, robot) if node in self._clocks}
        are_apart = (camera, robot) in self._apart
        return {node for node, clock in said.items() if clock.is_set or are_apart}

    def _words(self, node: str) -> str:
        clock = self._clocks[node]
        if clock.is_set:
            why = "its machine's clock was set and is not followed yet"
        else:
            side = "ahead of" if clock.ahead_s > 0 else "behind"
            why = (
                f"its clock is {abs(clock.ahead_s):.3f} s {side} fusion's; synchronise the clocks "
                "(chrony; trigpoint doctor)"
            )
        seen = "what it sees" if node.startswith("camera") else "what cameras see of it"
        return f"{node}: {seen} makes no corrections and is not learnt from: {why}"


def _nodes(camera: str, robot: str) -> tuple[str, str]:
    return f"camera {camera}", f"robot {robot}"
