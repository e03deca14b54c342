"""A ROS 2 robot without a port: by zenoh-bridge-ros2dds' keys, by rmw_zenoh's, and over DDS."""

import json
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest
from support.builders import eventually

from trigpoint.base.clock import to_ns
from trigpoint.bus.bus import Subscription
from trigpoint.contract.cdr import decode, encode, type_hash
from trigpoint.contract.correction import CorrectionMark, encode_mark
from trigpoint.contract.messages import ODOMETRY as ODOMETRY_TYPE
from trigpoint.contract.messages import Odometry, PoseEstimate, Transforms
from trigpoint.contract.topics import CORRECTED, CORRECTION, ODOMETRY, ROBOT_TF, Delivery, Topic
from trigpoint.geometry import Pose
from trigpoint.node.node import Node
from trigpoint.robot.ros2 import RosRobotNode
from trigpoint.site.config import parse_site
from trigpoint.testing.memory_bus import MemoryBroker

MAP = UUID(int=7)
MAP_FROM_ODOM = Pose.planar(10.0, 3.0, 1.0)
PERIOD_NS = to_ns(0.02)


@dataclass
class Desk:
    """A site with a robot on the bus, and a ROS 2 side that is imitated at the level of Zenoh."""

    folder: Path
    stack: ExitStack
    topic: str = "/r1/odom"
    broker: MemoryBroker = field(default_factory=MemoryBroker)

    def __post_init__(self) -> None:
        topic = f'topic = "{self.topic}"\n' if self.topic else ""
        text = (
            'site = "lab"\ntarget = "target.toml"\n[cameras.c1]\nsource = "sim://c1"\n'
            f"[robots.r1]\n{topic}"
        )
        self.site = parse_site(text, directory=self.folder)
        self.bus = self.stack.enter_context(self.broker.session())
        self.odometry = self.bus.subscribe(ODOMETRY, ODOMETRY.key("lab", "r1"))
        self.corrected = self.bus.subscribe(CORRECTED, CORRECTED.key("lab", "r1"))
        self.tf = self.bus.subscribe(ROBOT_TF, ROBOT_TF.key("lab", "r1"))
        answer = json.dumps({"map_id": str(MAP)}).encode()
        self.stack.enter_context(closing(self.bus.serve("lab/fusion/map", lambda _: answer)))
        self.sequence, self.number, self.begin_ns = 0, 0, time.time_ns()

    def start(self) -> Node:
        bus = self.stack.enter_context(self.broker.session())
        node = self.stack.enter_context(Node(bus, site="lab", kind="robot", name="r1"))
        RosRobotNode(bus, node, self.site, "r1").start()
        return node

    def reading(self) -> Odometry:
        """What the robot says next: frame names of its own, a slight tilt."""
        self.number += 1
        stamp_ns = self.begin_ns + self.number * PERIOD_NS
        time.sleep(max(0.0, (stamp_ns - time.time_ns()) / 1e9))
        pose = Pose.from_vector([0.008 * self.number, 0, 0.01, 0.02, 0, 0])
        return Odometry(stamp_ns, "odom", "base_link", pose)

    def correct(self, at: Odometry) -> None:
        """As fusion would, of the pose in the plane."""
        self.sequence += 1
        planar = Pose.planar(at.pose.translation[0], at.pose.translation[1], at.pose.heading)
        covariance = np.diag([1e-4, 1e-4, 0, 0, 0, 1e-4])
        estimate = PoseEstimate(at.stamp_ns, "map", MAP_FROM_ODOM @ planar, covariance)
        publisher = self.bus.publisher(CORRECTION, CORRECTION.key("lab", "r1"))
        mark = CorrectionMark(MAP, self.sequence)
        publisher.put(encode(estimate), attachment=encode_mark(mark))

    def drive(self, put: Any, readings: int) -> list[Odometry]:
        said = []
        for _ in range(readings):
            said.append(self.reading())
            put(encode(said[-1]))
            if len(said) % 5 == 0:
                self.correct(said[-3])
        return said


def all_of(subscription: Subscription, type_name: str) -> list[Any]:
    found = []
    while (sample := subscription.take(0.3)) is not None:
        found.append(decode(type_name, sample.payload))
    return found


def foreign(desk: Desk, key: str) -> Any:
    """A publisher as a bridge has it: plain, on a key that is not in the contract."""
    topic = Topic("foreign", "{id}", ODOMETRY_TYPE, Delivery.RELIABLE, queue=64)
    return desk.bus.publisher(topic, key).put


RMW_KEY = f"0/r1/odom/nav_msgs::msg::dds_::Odometry_/{type_hash(ODOMETRY_TYPE)}"


@pytest.mark.parametrize("key", ["r1/odom", RMW_KEY], ids=["ros2dds", "rmw_zenoh"])
def test_robots_odometry_is_brought_to_the_site_and_its_place_to_the_robot(
    tmp_path: Path, stack: ExitStack, key: str
) -> None:
    desk = Desk(tmp_path, stack)
    node = desk.start()
    said = desk.drive(foreign(desk, key), 120)
    brought = all_of(desk.odometry, ODOMETRY_TYPE)
    assert len(brought) == 120
    assert (brought[0].frame_id, brought[0].child_frame_id) == ("r1/odom", "r1/base")
    assert brought[-1].pose.translation[0] == pytest.approx(said[-1].pose.translation[0])
    assert brought[-1].pose.rotation[2, 2] == 1.0  # the tilt of an inertial sensor is left out
    poses = all_of(desk.corrected, CORRECTED.type_name)
    assert len(poses) > 10
    expected = MAP_FROM_ODOM @ Pose.planar(said[-1].pose.translation[0], 0, 0)
    by_stamp = {message.stamp_ns: message for message in said}
    last = poses[-1]
    assert last.stamp_ns in by_stamp
    np.testing.assert_allclose(last.pose.translation, expected.translation, atol=0.05)
    transforms = all_of(desk.tf, ROBOT_TF.type_name)
    assert isinstance(transforms[-1], Transforms)
    [transform] = transforms[-1].transforms
    assert (transform.parent, transform.child) == ("map", "odom")
    np.testing.assert_allclose(transform.pose.difference(MAP_FROM_ODOM), 0, atol=1e-3)
    assert node.health.total("frames_established") == 1


def test_robot_on_the_sites_own_key_is_not_said_twice(tmp_path: Path, stack: ExitStack) -> None:
    desk = Desk(tmp_path, stack, topic="")
    desk.start()
    desk.drive(foreign(desk, "lab/robot/r1/odom"), 100)
    assert len(all_of(desk.odometry, ODOMETRY_TYPE)) == 100
    assert all_of(desk.tf, ROBOT_TF.type_name)


def test_garbage_and_wrong_clocks_are_named(tmp_path: Path, stack: ExitStack) -> None:
    desk = Desk(tmp_path, stack)
    node = desk.start()
    put = foreign(desk, "r1/odom")
    put(b"garbage")
    put(encode(Odometry(time.time_ns() + to_ns(60.0), "odom", "base_link", Pose.identity())))
    assert eventually(lambda: node.health.total("rejected") == 1)
    assert eventually(lambda: node.health.lost("odometry_clock_off") == 1)
    assert "synchronise the two" in node.health.last_error


def test_dds_peer_reads_our_bytes_and_its_odometry_is_read(
    tmp_path: Path, stack: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CycloneDDS on loopback stands for a ROS 2 node; what the bridge does between DDS and Zenoh is
    handing on CDR, which is done here by hand."""
    pytest.importorskip("cyclonedds", reason="cyclonedds does not install here")
    monkeypatch.setenv(
        "CYCLONEDDS_URI",
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>"
        "</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
        "<Peers><Peer address='127.0.0.1'/></Peers></Discovery></Domain></CycloneDDS>",
    )
    from support.site.dds_peer import DdsOdometry

    desk = Desk(tmp_path, stack)
    desk.start()
    with closing(DdsOdometry(domain=int(time.time_ns() // 1000 % 200))) as peer:
        # Ours to DDS: what encode makes, a DDS reader takes apart.
        ours = Odometry(
            1_700_000_000_250_000_000, "r1/odom", "r1/base", Pose.planar(1.5, -2.0, 0.4)
        )
        heard = peer.decoded(encode(ours))
        assert (heard.header.stamp.sec, heard.header.stamp.nanosec) == (1_700_000_000, 250_000_000)
        assert heard.child_frame_id == "r1/base"
        assert heard.pose.pose.position.x == 1.5
        # Over DDS from a writer to a reader, on to Zenoh as the bridge hands it on, and in.
        put = foreign(desk, "r1/odom")
        for _ in range(20):
            put(peer.sent(desk.reading()))
    brought = all_of(desk.odometry, ODOMETRY_TYPE)
    assert len(brought) == 20
    assert brought[-1].pose.translation[0] == pytest.approx(0.16)
