"""A pose between two readings."""

from bisect import bisect_left
from collections.abc import Sequence

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import exp, log


def between(first: Pose, second: Pose, fraction: float) -> Pose:
    """The pose at `fraction` (0 … 1) of the way: linear in position, even in rotation."""
    turn = log(first.rotation.T @ second.rotation)
    way = second.translation - first.translation
    return Pose(first.rotation @ exp(fraction * turn), first.translation + fraction * way)


def interpolated(readings: Sequence[tuple[int, Pose]], stamp_ns: int) -> Pose | None:
    """The pose at a stamp, from `readings` in stamp order; None if outside their range."""
    index = bisect_left(readings, stamp_ns, key=lambda reading: reading[0])
    if index == len(readings):
        return None
    later_ns, later = readings[index]
    if later_ns == stamp_ns:
        return later
    if index == 0:
        return None
    earlier_ns, earlier = readings[index - 1]
    return between(earlier, later, (stamp_ns - earlier_ns) / (later_ns - earlier_ns))
