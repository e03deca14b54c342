"""Two secured sites over one router: a robot crosses over, its corrections never mix."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from support.builders import eventually
from support.site.secured import SecuredSite

from trigpoint.base.clock import SystemClock
from trigpoint.bus.bus import Bus
from trigpoint.contract.access import Identity, Kind
from trigpoint.contract.cdr import encode
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CORRECTION, ODOMETRY
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.robot.node import RobotNode
from trigpoint.security.authenticator import correction_signer
from trigpoint.zenoh import ZenohBus, open_router


class Fusion:
    """Who corrects the robots of one site, in its map."""

    def __init__(self, site: SecuredSite, number: int, stack: ExitStack) -> None:
        self.site, self._map = site, UUID(int=number)
        self.bus: Bus = stack.enter_context(ZenohBus(site.session(Kind.FUSION, "fusion")))
        self._signer = correction_signer(site.connecting, SystemClock())
        self._count = 0

    def correct(self, site: str) -> None:
        """Say a correction of robot r1 of a site: its own, or another one's."""
        self._count += 1
        key = CORRECTION.key(site, "r1")
        payload = encode(PoseEstimate(10**18, "map", Pose.planar(1.0, 2.0, 0.5), np.eye(6)))
        mark = encode_mark(CorrectionMark(self._map, self._count))
        publisher = self.bus.publisher(CORRECTION, key)
        publisher.put(payload, attachment=self._signer.sign(key, payload, mark))
        publisher.close()


@pytest.fixture
def fusions(
    tmp_path: Path, free_port: Callable[[], int], stack: ExitStack
) -> tuple[Fusion, Fusion]:
    """Those of the sites «east» and «west», which one router joins."""
    port = free_port()
    folders = [tmp_path / name for name in ("east", "west")]
    for folder in folders:
        folder.mkdir()
    east, west = (SecuredSite(folder, port, name=folder.name) for folder in folders)
    west.authority.admit(east.authority.anchor(Identity("east", Kind.ROUTER, "hall")))
    stack.enter_context(open_router(east.listening, west.connecting))
    return Fusion(east, 1, stack), Fusion(west, 2, stack)


class Bridge:
    """The bridge of robot r1 while it is in one site."""

    def __init__(self, site: SecuredSite, stack: ExitStack) -> None:
        bus = stack.enter_context(ZenohBus(site.session(Kind.ROBOT, "r1")))
        self.node = Node(bus, site=site.name, kind="robot", name="r1")
        bridge = RobotNode(bus, self.node, site.connecting, "r1")
        stack.enter_context(self.node)
        bridge.start()

    @property
    def judged(self) -> int:
        return self.node.health.total("corrections")

    @property
    def rejected(self) -> int:
        return self.node.health.total("rejected")


def test_robot_that_crosses_over_hears_the_fusion_of_where_it_is(
    fusions: tuple[Fusion, Fusion],
) -> None:
    for here, there in (fusions, fusions[::-1]):
        with ExitStack() as stay:
            bridge = Bridge(here.site, stay)

            def is_corrected(bridge: Bridge = bridge, here: Fusion = here) -> bool:
                here.correct(here.site.name)
                return bridge.judged > 0

            assert eventually(is_corrected)
            for _ in range(20):
                there.correct(there.site.name)
                there.correct(here.site.name)  # what the rules forbid
            judged = bridge.judged
            here.correct(here.site.name)
            assert eventually(lambda bridge=bridge, n=judged: bridge.judged > n)
            assert bridge.rejected == 0
            assert bridge.node.health.lost("corrections") == 0


def test_odometry_stays_in_its_site(fusions: tuple[Fusion, Fusion], stack: ExitStack) -> None:
    east, west = fusions
    wanted = east.bus.subscribe(ODOMETRY, "east/robot/*/odom")
    strange = [west.bus.subscribe(ODOMETRY, f"{name}/robot/*/odom") for name in ("east", "*")]
    robot = stack.enter_context(ZenohBus(east.site.session(Kind.ROBOT, "r1")))
    publisher = robot.publisher(ODOMETRY, ODOMETRY.key("east", "r1"))
    publisher.put(b"here")
    assert wanted.take(60.0) is not None
    assert [subscription.take(0.3) for subscription in strange] == [None, None]


def test_others_site_cannot_sign_for_this_one(fusions: tuple[Fusion, Fusion]) -> None:
    """Were it let through by a relay, the bridge would not believe it."""
    east, west = fusions
    with ExitStack() as stay:
        bridge = Bridge(east.site, stay)
        key = CORRECTION.key("east", "r1")
        payload = encode(PoseEstimate(10**18, "map", Pose.planar(1.0, 2.0, 0.5), np.eye(6)))
        forged = west._signer.sign(key, payload, encode_mark(CorrectionMark(UUID(int=2), 1)))
        publisher = east.bus.publisher(CORRECTION, key)

        def is_rejected() -> bool:
            publisher.put(payload, attachment=forged)
            return bridge.rejected > 0

        assert eventually(is_rejected)
        assert bridge.judged == 0
        assert "is not fusion's" in bridge.node.health.last_error
