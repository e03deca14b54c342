"""The robot bridge as a node: connects the port, the bridge and the bus."""

import logging
import os
from pathlib import Path

from trigpoint.base.clock import Clock, to_seconds
from trigpoint.base.errors import ConfigError, read_text
from trigpoint.bus.bus import Bus, Publisher
from trigpoint.contract.cdr import encode, warm_up
from trigpoint.contract.topics import CORRECTION, ODOMETRY
from trigpoint.node.clock_watch import ClockWatch
from trigpoint.node.node import Node
from trigpoint.site.config import Site

from .bridge import Bridge, first_number
from .corrections import Corrections, subscribed
from .line.line import Line
from .line.port import PortOpener, is_device, lasting_name
from .line.protocol import Event, RobotCorrection, Setup, Takes, make_protocol
from .odometry.stamps import measured_offset
from .places import Places
from .quiet import CorrectionWatch, OdometryWatch
from .relocation import MapQuestion

_log = logging.getLogger(__name__)

KIND = "robot"


class RobotNode:
    """Runs inside `node`'s life: `start` declares and starts, the node's end stops."""

    def __init__(
        self, bus: Bus, node: Node, site: Site, robot: str, *, clock: Clock | None = None
    ) -> None:
        self._bus, self._node, self._site, self._robot = bus, node, site, robot
        self._clock = clock or node.clock
        config = site.robot(robot)
        url = port_url(site, robot)
        protocol = make_protocol(protocol_setup(site, robot, self._clock))
        self._traits = protocol.traits
        number = first_number(self._clock.now_ns())
        offset = measured_offset(self._clock)
        self._bridge = Bridge(robot, config, node.health, offset, protocol.traits, number=number)
        self._line = Line(
            PortOpener(url, config.baud).open,
            protocol,
            clock=self._clock,
            handle=self._handle,
            failed=node.health.fail,
        )
        self._odometry_watch = OdometryWatch(
            robot, config.protocol_name, self._line, self._bridge, node.health
        )
        self._correction_watch = CorrectionWatch(
            robot, self._bridge, node, CORRECTION.key(site.name, robot)
        )
        self._clock_watch = ClockWatch(
            bus,
            node,
            site,
            lambda: self._bridge.unix_ns(self._clock.elapsed_ns()),
            config.odometry.bearable_clock_offset_s,
            "corrections are held",
        )
        self._corrections = Corrections(
            site,
            self._bridge,
            node.health,
            self._clock,
            self._hand_on,
            lambda: self._clock_watch.is_off,
        )
        self._odometry_key = ODOMETRY.key(site.name, robot)
        self._publisher: Publisher | None = None
        self._places: Places | None = None

    def start(self) -> None:
        """Declare the bridge's publishers and subscribers, and start its threads."""
        warm_up()
        self._publisher = self._bus.publisher(ODOMETRY, self._odometry_key)
        if self._traits.takes is not Takes.CORRECTIONS:
            self._places = Places(self._bus, self._site.name, self._robot, self._node.health)
        corrections = subscribed(self._bus, self._site, self._robot)
        self._show()
        node = self._node
        node.work("reads", lambda pulse: self._line.read_until(node.stopping, pulse.beat))
        node.work("writes", lambda pulse: self._line.write_until(node.stopping, pulse.beat))
        node.work("corrects", lambda pulse: self._corrections.run(corrections, node, pulse))
        question = MapQuestion(self._bus, node, self._site.name, self._bridge, self._clock)
        node.work("asks", question.run)
        node.work("clock", self._clock_watch.run)
        url = port_url(self._site, self._robot)
        if (lasting := lasting_name(url)) not in ("", url):
            _log.info("%s: port %s is also %s, a name that stays", node.label, url, lasting)
        for lack in self._traits.lacks:
            _log.warning("%s: %s", node.label, lack)

    def _show(self) -> None:
        health, bridge = self._node.health, self._bridge
        health.gauge("port_open", lambda: float(self._line.is_open))
        health.gauge("connected", lambda: float(bridge.connected is not None))
        health.gauge("clock_round_trip_us", lambda: bridge.clock.round_trip_us)
        health.gauge("clock_drift_ppm", lambda: bridge.clock.drift_ppm)
        health.gauge("clock_jumps", lambda: bridge.clock.jumps)
        health.gauge("firmware_clock_s", self._firmware_clock_s)
        health.gauge("firmware_received", lambda: bridge.vitals.received)
        health.gauge("firmware_rejected", lambda: bridge.vitals.rejected)
        health.gauge("port_opened", lambda: self._line.opened)

    def _firmware_clock_s(self) -> float:
        """The firmware clock's reading, 0 if unknown. It is called once a second, so it also lets
        the bridge follow this machine's clock if that was set, and notices what does not come."""
        self._bridge.follow(self._clock)
        self._odometry_watch.look(self._clock.elapsed_ns())
        self._correction_watch.look(self._clock.elapsed_ns())
        zero_ns = self._bridge.clock.machine_ns(0)
        return 0.0 if zero_ns is None else to_seconds(self._clock.elapsed_ns() - zero_ns)

    def _handle(self, event: Event) -> None:
        odometry = self._bridge.on_event(event)
        if odometry is not None and self._publisher is not None:
            self._publisher.put(encode(odometry))
            self._node.health.count(f"sent {self._odometry_key}")
            self._locate()

    def _locate(self) -> None:
        """Send its pose to a robot that takes no corrections, and to the bus."""
        if self._places is None or (location := self._bridge.locate()) is None:
            return
        if self._traits.takes is Takes.POSES:
            self._line.locate(location.for_robot)
        self._places.publish(location)

    def _hand_on(self, correction: RobotCorrection) -> None:
        if self._traits.takes is Takes.CORRECTIONS:
            self._line.correct(correction)


def protocol_setup(site: Site, robot: str, clock: Clock) -> Setup:
    """The setup of a robot's protocol; its boot number repeats an earlier bridge's only with a
    chance of one in four thousand million. Raise ConfigError if a signing key is invalid."""
    config = site.robot(robot)
    key = b"" if config.mavlink.key is None else _signing_key(site.path(config.mavlink.key))
    return Setup(robot, config, int.from_bytes(os.urandom(4)), clock.now_ns(), key)


def _signing_key(path: Path) -> bytes:
    text = read_text(path, "signing key", ConfigError).strip()
    if len(text) != 64 or set(text.lower()) - set("0123456789abcdef"):
        raise ConfigError(f"{path} holds no signing key; write 64 hexadecimal digits")
    return bytes.fromhex(text)


def port_url(site: Site, robot: str) -> str:
    """The port to open; a relative path is relative to the site file, like every path in it."""
    port = site.robot(robot).port
    assert port is not None  # guaranteed by the site file's check, except for robots on the bus
    return str(site.path(port)) if is_device(port) and "/" in port else port
