"""How a robot moves from its nodes to the moments at which a camera sees it."""

import numpy as np

from trigpoint.base.clock import NANOSECONDS, to_ns
from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.problem import Carried, Chain
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import OdometryNoise

PERIOD_NS = to_ns(0.05)
STOPS, STARTS, ENDS = 4, 20, 30
SCALES = np.array([0.01, -0.02])
OFFSET_S = 0.0123


def chain() -> Chain:
    """A robot that drives, stands and drives on, with a node at its start and one for its stay."""
    track = OdometryTrack(OdometryNoise(), planar=True)
    for number in range(ENDS):
        driven = min(number, STOPS) + max(number - STARTS, 0)
        track.add(number * PERIOD_NS, Pose.planar(0.02 * driven, 0.003 * driven, 0.04 * driven))
    return Chain.unlinked("r1", np.array([PERIOD_NS, STOPS * PERIOD_NS]), track, SCALES)


def seen(numbers: list[float]) -> tuple[Carried, np.ndarray]:
    """Sightings from the stay's node at these messages, and after which time."""
    times_ns = np.round(np.array(numbers) * PERIOD_NS).astype(np.int64)
    nodes = np.ones(len(numbers), dtype=int)
    stamps_ns = times_ns + to_ns(OFFSET_S)
    carried = Carried.of(chain(), nodes, stamps_ns, np.full(len(numbers), OFFSET_S))
    return carried, (times_ns - STOPS * PERIOD_NS) / NANOSECONDS


def change(carried: Carried, by_s: float) -> Array:
    before, after = (carried.at(np.full(len(carried.offset_s), OFFSET_S + d)) for d in (0.0, by_s))
    return after.difference(before)


def test_with_the_assumed_offset_it_is_the_odometry_s_motion() -> None:
    numbers = [STOPS + 0.5, STARTS - 0.1, STARTS, STARTS + 0.3, STARTS + 2]
    carried, after_s = seen(numbers)
    start_ns = np.full(len(numbers), STOPS * PERIOD_NS)
    expected, _ = chain().track.carried(start_ns, after_s, SCALES)
    found = carried.at(np.full(len(numbers), OFFSET_S))
    np.testing.assert_allclose(found.difference(expected), 0.0, atol=1e-12)


def test_another_offset_moves_it_along_its_way() -> None:
    carried, after_s = seen([STARTS + 0.5, STARTS + 2.5])
    expected, _ = chain().track.carried(np.full(2, STOPS * PERIOD_NS), after_s - 0.004, SCALES)
    found = carried.at(np.full(2, OFFSET_S + 0.004))
    np.testing.assert_allclose(found.difference(expected), 0.0, atol=1e-5)


def test_where_the_robot_starts_the_motion_is_differentiable_by_the_offset() -> None:
    """Just at a message, as a camera that is triggered with the odometry sees it, and long after
    its node: a solver that meets a kink there does not come to rest."""
    carried, _ = seen([STARTS])
    earlier, later = change(carried, 1e-4), change(carried, -1e-4)
    assert np.abs(later[0, 0]) > 1e-6
    np.testing.assert_allclose(later, -earlier, rtol=1e-2, atol=1e-12)
    np.testing.assert_allclose(later[:, 0], 1e-4 * carried.twists[:, 0], rtol=1e-3)
