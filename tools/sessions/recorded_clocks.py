"""Cameras and robots whose stamps lie otherwise to the times of recording.

Stamps of two clocks that overlap fit together in every other way: pictures are held against where
the robot was at another time. Whoever recorded both saw both come.
"""

import math
from array import array
from collections.abc import Iterator, Sequence

import numpy as np

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.site.config import OFFSET_SIGMAS, Site

# A picture is searched, and what is sent comes, within a second; fewer messages say little.
_LEAST_NS, _LEAST = to_ns(1.0), 3
# Of a node's messages: what a break held up came late.
_SHARES = 0.1, 0.5, 0.9
# Nothing comes later than this time after time.
_LATEST_NS = to_ns(10.0)
# No clock is off by more, whatever a damaged file says.
_MOST_NS = 2**61


class RecordedClocks:
    """By how much the stamps of each node lie before the times of recording."""

    def __init__(self) -> None:
        self._late_ns: dict[str, array[int]] = {}

    def add(self, node: str, stamps_ns: Sequence[int], logs_ns: Sequence[int]) -> None:
        """Take messages of a camera or robot by their stamps and when they were recorded."""
        late_ns = (log - stamp for stamp, log in zip(stamps_ns, logs_ns, strict=True))
        bounded = (min(max(each, -_MOST_NS), _MOST_NS) for each in late_ns)
        self._late_ns.setdefault(node, array("q")).extend(bounded)

    def apart(self, site: Site) -> dict[str, str]:
        """Camera -> what is to be said, where a robot's clock is further from its own than the
        site allows, and than either of the two scatters."""
        late = {node: _quantiles(all_ns) for node, all_ns in self._late_ns.items()}
        robots = {robot: late[robot] for robot in site.robots if robot in late}
        cameras = {camera: late[camera] for camera in site.cameras if camera in late}
        return {
            camera: words
            for camera, own in cameras.items()
            for words in _words(camera, own, robots, to_ns(site.cameras[camera].most_time_offset_s))
        }


def _quantiles(late_ns: Sequence[int]) -> tuple[int, int, int]:
    """Of a node, from its median; what is too few scatters without end."""
    if len(late_ns) < _LEAST:
        return -_MOST_NS, 0, _MOST_NS
    low, middle, high = np.quantile(np.array(late_ns), _SHARES, method="nearest").tolist()
    return low, middle, high


def _words(
    camera: str, own: tuple[int, int, int], robots: dict[str, tuple[int, int, int]], borne_ns: int
) -> Iterator[str]:
    for robot, (low, middle, high) in robots.items():
        ahead_ns = own[1] - middle
        scatter_ns = own[2] - own[0] + high - low
        if abs(ahead_ns) > max(_LEAST_NS, borne_ns) + scatter_ns:
            way, late = ("ahead of", camera) if ahead_ns > 0 else ("behind", robot)
            sigma = math.ceil(10 * to_seconds(abs(ahead_ns)) / OFFSET_SIGMAS) / 10
            remedy = (
                f", or, if what {late} sends only comes that late, write time_offset_sigma = "
                f"{sigma} for {camera}"
            )
            yield (
                f"the stamps of {robot} are {to_seconds(abs(ahead_ns)):.1f} s {way} those of "
                f"{camera} by when both were recorded, so its pictures are held against where "
                f"{robot} was at other times; synchronise the clocks (chrony)"
                f"{remedy if abs(ahead_ns) < _LATEST_NS else ''}"
            )
