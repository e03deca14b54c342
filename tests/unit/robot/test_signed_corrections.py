"""In a secured site the bridge takes fusion's own corrections, each once, and counts the rest."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from support.builders import eventually, site_text

from trigpoint.base.clock import SystemClock
from trigpoint.bus.bus import Publisher
from trigpoint.cli import run
from trigpoint.contract.cdr import encode
from trigpoint.contract.correction import CorrectionMark, MissedCorrections, encode_mark
from trigpoint.contract.messages import PoseEstimate
from trigpoint.contract.topics import CORRECTION
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.robot.node import RobotNode
from trigpoint.security.authenticator import Signer, correction_signer
from trigpoint.site.config import load_site
from trigpoint.testing.memory_bus import MemoryBroker

KEY = CORRECTION.key("lab", "r1")
MAP = UUID(int=5)


class Desk:
    """A bridge without a robot, and who sends it corrections."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        path = folder / "site.toml"
        path.write_text(site_text(bus='listen = ["tls/127.0.0.1:7447"]\n[bus.tls]'))
        for words in (("init",), ("node", "fusion", "fusion")):
            assert run(["secure", *words, "--site", str(path)]) == 0
        site, broker = load_site(path), MemoryBroker()
        bus, fusion = stack.enter_context(broker.session()), stack.enter_context(broker.session())
        self.node = Node(bus, site="lab", kind="robot", name="r1")
        bridge = RobotNode(bus, self.node, site, "r1")
        self.signer: Signer = correction_signer(site, SystemClock())
        stack.enter_context(self.node)
        bridge.start()
        self.publisher: Publisher = fusion.publisher(CORRECTION, KEY)

    def said(self, sequence: int) -> tuple[bytes, bytes]:
        """A correction as fusion makes it: payload and attachment."""
        pose = PoseEstimate(10**18, "map", Pose.planar(1.0, 2.0, 0.5), np.eye(6))
        payload = encode(pose)
        mark = encode_mark(CorrectionMark(MAP, sequence))
        return payload, self.signer.sign(KEY, payload, mark)

    def counts(self) -> tuple[int, int]:
        """(judged, rejected before that)."""
        return self.node.health.total("corrections"), self.node.health.total("rejected")


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with ExitStack() as stack:
        yield Desk(tmp_path, stack)


def test_fusions_correction_is_judged_once(desk: Desk) -> None:
    payload, attachment = desk.said(1)
    desk.publisher.put(payload, attachment=attachment)
    assert eventually(lambda: desk.counts() == (1, 0))
    desk.publisher.put(payload, attachment=attachment)
    assert eventually(lambda: desk.counts() == (1, 1))
    assert "said again" in desk.node.health.last_error


def test_unsigned_correction_is_not_judged(desk: Desk) -> None:
    payload, attachment = desk.said(1)
    desk.publisher.put(payload, attachment=attachment[:24])
    assert eventually(lambda: desk.counts() == (0, 1))
    desk.publisher.put(payload[:-1] + b"\x7f", attachment=attachment)
    assert eventually(lambda: desk.counts() == (0, 2))
    assert "is not fusion's" in desk.node.health.last_error


def test_corrections_that_never_came_are_counted(desk: Desk) -> None:
    for sequence in (1, 2, 6):
        payload, attachment = desk.said(sequence)
        desk.publisher.put(payload, attachment=attachment)
    assert eventually(lambda: desk.counts() == (3, 0))
    assert desk.node.health.lost("corrections") == 3


def test_new_map_and_new_numbers_are_no_loss() -> None:
    missed = MissedCorrections()
    other = UUID(int=6)
    said = [(MAP, 5, "a"), (MAP, 9, "a"), (other, 100, "a"), (other, 2, "a"), (other, 2000, "b")]
    counts = [missed.before(CorrectionMark(who, number), sender) for who, number, sender in said]
    assert counts == [0, 3, 0, 0, 0]
