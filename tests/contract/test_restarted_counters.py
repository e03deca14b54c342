"""A robot whose counters restart: what the bridge makes of it is what fusion can go on with."""

from collections.abc import Iterator

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Sent, Session, lab_plan, make_session, pushed
from support.fusion.honesty import assert_honest

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.robot.line.protocol import Reading
from trigpoint.robot.odometry.odometry import OdometryStream

CUT_NS = EPOCH_NS + to_ns(12.0)


def restarted(session: Session, *, away_s: float) -> Session:
    """The session of a robot whose firmware restarts at 12 s, counts from zero in a frame of its
    own, and says nothing for a while, in which the robot drives on."""
    stream, back_ns = OdometryStream("r1"), CUT_NS + to_ns(away_s)

    def through_the_bridge() -> Iterator[tuple[str, Sent]]:
        begun = None
        for node, message in session.messages:
            if not isinstance(message, Odometry):
                yield node, message
                continue
            if CUT_NS < message.stamp_ns <= back_ns:
                continue
            if message.stamp_ns > CUT_NS and begun is None:
                begun = message.pose
                stream.restart()
            counted = message.pose if begun is None else begun.inverse() @ message.pose
            reading = Reading(message.stamp_ns, message.stamp_ns, counted, np.zeros(3), np.zeros(3))
            published = stream.add(reading, message.stamp_ns)
            assert published is not None
            yield node, published

    return replace(session, messages=tuple(through_the_bridge()))


@pytest.mark.parametrize(("away_s", "unknown"), [(0.0, 0), (0.5, 0), (2.0, 1)])
def test_map_goes_on_where_the_counters_restart(away_s: float, unknown: int) -> None:
    """After a long silence the odometry says nothing of the motion in it, and fusion knows that."""
    session = restarted(make_session(lab_plan("charuco")), away_s=away_s)
    pipeline = pushed(session.inputs, session.messages)
    results = pipeline.results()
    assert_honest(session, results)
    assert pipeline.left_out.get("odometry_jumps", 0) == unknown
    _, poses = results.trajectories["r1"]
    assert np.abs(poses[-1].difference(session.truth["r1"][-1])).max() < 0.05
