"""How long corrections take to the bridge."""

from pathlib import Path
from uuid import UUID

import numpy as np
from support.builders import site_text

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.bus.bus import Sample
from trigpoint.contract.cdr import encode
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CORRECTION
from trigpoint.geometry import Pose
from trigpoint.node.health import Health
from trigpoint.robot.bridge import Bridge
from trigpoint.robot.corrections import Corrections
from trigpoint.robot.odometry.stamps import Offset
from trigpoint.site.config import RobotConfig, parse_site

EXPOSED_NS = to_ns(1_700_000_000.0)


def test_a_correction_is_timed_from_exposure_and_from_its_sending() -> None:
    clock = ManualClock(EXPOSED_NS + to_ns(0.080))
    health = Health(clock)
    bridge = Bridge("r1", RobotConfig(port="x"), health, Offset(0))
    site = parse_site(site_text(), directory=Path())
    corrections = Corrections(site, bridge, health, clock, lambda _: None)
    payload = encode(PoseEstimate(EXPOSED_NS, "map", Pose.planar(1.0, 2.0, 0.5), np.eye(6)))
    mark = encode_mark(CorrectionMark(UUID(int=5), 1))
    came_ns = clock.now_ns()
    sent_ns = came_ns - to_ns(0.004)
    key = CORRECTION.key("lab", "r1")
    corrections.take(Sample(key, payload, CORRECTION.encoding, sent_ns, came_ns, mark))
    values = health.report().values
    assert values["correction_transit.seconds"] == "0.004000 0 0 1"
    assert values["correction_delay.seconds"] == "0.080000 0 0 0 0 0 0 1"
