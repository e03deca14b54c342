"""Cameras and robots whose clocks cannot be relied on, as they say themselves.

A robot that is seen at a moment by a camera's clock is placed by its odometry of that moment by its
own; so what counts is how far the two are apart. Fusion's clock, by which both say it, may be the
one that is off.
"""

from collections.abc import Iterable

from trigpoint.contract.clock_doubt import CLOCK_SET_BY, ahead_s
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus
from trigpoint.site.config import Site


class ClockDoubts:
    """Whose clocks are in doubt. `open`: what is to be said of each such camera or robot."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._known = {f"edge/{name}": f"camera {name}" for name in site.cameras}
        self._known |= {f"robot/{name}": f"robot {name}" for name in site.robots}
        self._ahead_s: dict[str, float] = {}
        self._set: set[str] = set()
        self.open: dict[str, str] = {}

    def hear(self, message: Diagnostics) -> list[str]:
        """Take what nodes say of themselves; what is to be said of those newly in doubt."""
        for status in message.statuses:
            if status.name in self._known:
                self._take(self._known[status.name], status)
        before, doubted = self.open, self._doubted()
        self.open = {node: self._words(node) for node in sorted(doubted)}
        return [words for node, words in self.open.items() if node not in before]

    def _take(self, node: str, status: DiagnosticStatus) -> None:
        self._ahead_s.pop(node, None)
        self._set.discard(node)
        if found_s := ahead_s(status):
            self._ahead_s[node] = found_s
        if CLOCK_SET_BY in status.values:
            self._set.add(node)

    def why(self, camera: str, robots: Iterable[str]) -> str:
        """Why what a camera sees of any of these robots is not to be used; "" where it is."""
        if not self.open:
            return ""
        doubted = {node for robot in robots for node in self._doubted_of(camera, robot)}
        return "; ".join(self.open[node] for node in sorted(doubted))

    def _doubted_of(self, camera: str, robot: str) -> set[str]:
        """Which of the two say of themselves why they do not go together."""
        both = {f"camera {camera}", f"robot {robot}"}
        apart_s = self._ahead_s.get(f"camera {camera}", 0) - self._ahead_s.get(f"robot {robot}", 0)
        are_apart = abs(apart_s) > self._site.bearable_clock_offset_s(camera)
        return both & (self._set | (self._ahead_s.keys() if are_apart else set()))

    def _doubted(self) -> set[str]:
        if not (self._ahead_s or self._set):
            return set()
        pairs = [(camera, robot) for camera in self._site.cameras for robot in self._site.robots]
        return {node for camera, robot in pairs for node in self._doubted_of(camera, robot)}

    def _words(self, node: str) -> str:
        if node in self._set:
            why = "its machine's clock was set and is not followed yet"
        else:
            ahead_s = self._ahead_s[node]
            side = "ahead of" if ahead_s > 0 else "behind"
            why = (
                f"its clock is {abs(ahead_s):.3f} s {side} fusion's; synchronise the clocks "
                "(chrony; trigpoint doctor)"
            )
        seen = "what it sees" if node.startswith("camera") else "what cameras see of it"
        return f"{node}: {seen} makes no corrections and is not learnt from: {why}"
