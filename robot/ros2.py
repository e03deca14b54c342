"""A robot that speaks ROS 2: no port; its odometry comes on the bus (docs/how-to/ros2.md).

Through zenoh-bridge-ros2dds a topic's key is its name without the first slash; through rmw_zenoh it
is `<domain>/<topic>/<type>/<hash>`. Either way the payload is the message's CDR without an
encoding: the key fixes the type, decoding checks it. Corrections are judged as for every robot; the
result is published as a pose and as the transform from the map to the robot's own odometry frame.
"""

import logging
from collections.abc import Callable

from trigpoint.base.clock import Clock
from trigpoint.base.errors import MessageError
from trigpoint.bus.bus import Bus, Publisher, Sample, Subscription
from trigpoint.contract.cdr import decode, encode, warm_up
from trigpoint.contract.messages import Odometry
from trigpoint.contract.topics import CORRECTION, ODOMETRY, Delivery, Topic
from trigpoint.geometry import Pose
from trigpoint.node.health import Health, mended_count
from trigpoint.node.node import Node
from trigpoint.node.watchdog import Pulse
from trigpoint.site.config import Site

from .bridge import Bridge
from .corrections import Corrections, subscribed
from .line.protocol import Connected, Event, Reading, RobotCorrection, StampClock, Takes, Traits
from .odometry.stamps import measured_offset
from .places import Places
from .quiet import CorrectionWatch
from .relocation import MapQuestion

_log = logging.getLogger(__name__)

TRAITS = Traits(
    Takes.NOTHING,
    StampClock.UNIX,
    ("a ROS 2 robot is told where it is by tf (map to its odometry frame) and a pose: remap both",),
)
_TAKE_S = 0.2
# Half a minute of a fast robot; a plain subscription, as ROS publishers keep no history.
FOREIGN = Topic("ros_odom", "{id}", ODOMETRY.type_name, Delivery.RELIABLE, queue=4096)
_RMW_TYPE = "nav_msgs::msg::dds_::Odometry_"


def foreign_keys(topic: str) -> tuple[str, str]:
    """The key expressions of a ROS topic: for zenoh-bridge-ros2dds, for rmw_zenoh."""
    key = topic.strip("/")
    return key, f"*/{key}/{_RMW_TYPE}/*"


class RosRobotNode:
    """Runs inside `node`'s life, like `RobotNode` for robots at a port."""

    def __init__(
        self, bus: Bus, node: Node, site: Site, robot: str, *, clock: Clock | None = None
    ) -> None:
        self._bus, self._node, self._site, self._robot = bus, node, site, robot
        self._clock = clock or node.clock
        config = site.robot(robot)
        self._key = ODOMETRY.key(site.name, robot)
        self._expressions = foreign_keys(ros_topic(site, robot))
        offset = measured_offset(self._clock)
        self._bridge = Bridge(robot, config, node.health, offset, TRAITS)
        self._corrections = Corrections(site, self._bridge, node.health, self._clock, self._hand_on)
        self._correction_watch = CorrectionWatch(
            robot, self._bridge, node, CORRECTION.key(site.name, robot)
        )
        self._publisher: Publisher | None = None
        self._places: Places | None = None

    def start(self) -> None:
        """Declare the bridge's publishers and subscribers, and start its threads."""
        warm_up()
        node, name = self._node, self._site.name
        self._publisher = self._bus.publisher(ODOMETRY, self._key)
        self._places = Places(self._bus, name, self._robot, node.health)
        corrections = subscribed(self._bus, self._site, self._robot)
        node.health.gauge("odometry_ahead_ms", self._odometry_ahead_ms)
        for expression in self._expressions:
            samples = self._bus.subscribe(FOREIGN, expression)
            node.health.watch(f"odometry {expression}", samples)
            node.work(f"reads {expression}", self._reader(samples))
        node.work("corrects", lambda pulse: self._corrections.run(corrections, node, pulse))
        question = MapQuestion(self._bus, node, name, self._bridge, self._clock)
        node.work("asks", question.run)
        _log.info("%s waits for odometry on %s", node.label, " and ".join(self._expressions))

    def _odometry_ahead_ms(self) -> float:
        """How far the robot's clock is ahead. It is called once a second, so it also lets the
        bridge follow this machine's clock if that was set, and notices missing corrections."""
        self._bridge.follow(self._clock)
        self._correction_watch.look(self._clock.elapsed_ns())
        return 1e3 * self._bridge.odometry_ahead_s

    def _reader(self, samples: Subscription) -> Callable[[Pulse], None]:
        def read(pulse: Pulse) -> None:
            while not self._node.stopping.is_set():
                pulse.beat()
                sample = samples.take(_TAKE_S)
                if sample is not None:
                    self._read(sample)

        return read

    def _read(self, sample: Sample) -> None:
        if sample.sender == self._bus.identity:
            return  # our own message
        try:
            events = reading_of(sample, self._bridge, self._node.health, self._clock)
        except MessageError as reason:
            self._node.health.reject(sample, reason)
            return
        odometry = None
        for event in events:
            odometry = self._bridge.on_event(event)
        if odometry is None:
            return
        # Messages on our own key have been read there by everyone.
        if self._publisher is not None and sample.key != self._key:
            self._publisher.put(encode(odometry))
            self._node.health.count(f"sent {self._key}")
        location = self._bridge.locate()
        if location is not None and self._places is not None:
            who = self._bridge.connected
            self._places.publish(location, own_odom=who.firmware if who else "odom")

    def _hand_on(self, _correction: RobotCorrection) -> None:
        """Nothing to send now: the pose goes out with the next odometry."""


def ros_topic(site: Site, robot: str) -> str:
    """The topic of a robot's odometry: the site file's, or the site's own key."""
    return site.robot(robot).topic or ODOMETRY.key(site.name, robot)


def reading_of(sample: Sample, bridge: Bridge, health: Health, clock: Clock) -> list[Event]:
    """The reading in an odometry sample; raise MessageError if it is not odometry. The first one
    connects the robot, which is identified by the name of its odometry frame."""
    message = decode(ODOMETRY.type_name, sample.payload)
    assert isinstance(message, Odometry)  # guaranteed by the type
    for lack in message.mended:
        health.count(mended_count(lack))
    pose = _level(message.pose) if bridge.is_planar else message.pose
    received_ns = clock.elapsed_ns()
    reading = Reading(message.stamp_ns, received_ns, pose, message.linear, message.angular)
    if bridge.connected is None:
        return [Connected(bridge.robot, message.frame_id or "odom", 0), reading]
    return [reading]


def _level(pose: Pose) -> Pose:
    """x, y and heading of odometry into which the robot has fused an inertial sensor's tilt."""
    x, y, _ = pose.translation
    return Pose.planar(x, y, pose.heading)
