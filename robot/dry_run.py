"""`--dry-run`: reads the robot for a few seconds, reports what came and what would be sent.

Corrections on the bus are judged as usual, but only reported. The robot itself is only asked who
it is and what its clock reads.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import Clock, SystemClock, to_ns
from trigpoint.base.errors import BusError, MessageError, OperationError
from trigpoint.base.words import counted
from trigpoint.bus.bus import Bus, Subscription
from trigpoint.contract.messages import Mended
from trigpoint.node.health import Health, mended_count
from trigpoint.site.config import ROS2_PROTOCOL, Site

from .bridge import Bridge
from .corrections import Corrections, subscribed
from .line.line import Line
from .line.port import PortOpener
from .line.protocol import Event, Mismatched, RobotCorrection, Takes, Traits, make_protocol
from .node import port_url, protocol_setup
from .odometry.stamps import measured_offset
from .quiet import why_nothing
from .relocation import ask_for_map
from .ros2 import FOREIGN, TRAITS, foreign_keys, reading_of, ros_topic

SECONDS = 5.0
_TROUBLE = ("serial_framing_errors", "serial_checksum_errors", "serial_content_errors")
_UNUSED = ("odometry_clock_off", "odometry_impossible", "odometry_out_of_order")
_SLICE_S = 0.05
Say = Callable[[str], None]


class Glance(Struct, frozen=True):
    """One second of a dry run."""

    odometry: int
    x: float
    y: float
    heading_rad: float
    round_trip_us: float
    drift_ppm: float
    missing: int
    damaged: int

    def __str__(self) -> str:
        return (
            f"{self.odometry:4d} odometry messages in this second, at x {self.x:.3f} m, "
            f"y {self.y:.3f} m, heading {self.heading_rad:.3f} rad; clock: round trip "
            f"{self.round_trip_us:.0f} µs, drift {self.drift_ppm:+.1f} ppm; "
            f"{self.missing} frames missing, {self.damaged} damaged"
        )


class _Session:
    """The robot's side: the threads on its line, or its topic on the bus, and what they saw."""

    def __init__(self, site: Site, robot: str, clock: Clock) -> None:
        self.site, self.robot, self.clock = site, robot, clock
        self.config = site.robot(robot)
        self.health = Health(clock)
        self.stopping = threading.Event()
        self.trouble = ""
        self.pose = (0.0, 0.0, 0.0)
        self.line: Line | None = None
        self._said = ""
        traits = TRAITS
        if self.config.protocol_name != ROS2_PROTOCOL:
            traits = self._open_line()
        self.traits = traits
        offset = measured_offset(clock)
        self.bridge = Bridge(robot, self.config, self.health, offset, traits)

    def _open_line(self) -> Traits:
        url = port_url(self.site, self.robot)
        opener = PortOpener(url, self.config.baud)
        opener.open().close()  # raises at once if it cannot be opened
        protocol = make_protocol(protocol_setup(self.site, self.robot, self.clock))
        self.line = Line(
            opener.open, protocol, clock=self.clock, handle=self.handle, failed=self._fail
        )
        return protocol.traits

    @contextmanager
    def running(self) -> Iterator[None]:
        runs = (self.line.read_until, self.line.write_until) if self.line else ()
        threads = [threading.Thread(target=run, args=(self.stopping,)) for run in runs]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self.stopping.set()
            for thread in threads:
                thread.join()

    def handle(self, event: Event) -> None:
        if isinstance(event, Mismatched):
            self._fail(event.text)
        odometry = self.bridge.on_event(event)
        if odometry is not None:
            x, y, _ = (float(value) for value in odometry.pose.translation)
            self.pose = (x, y, float(odometry.pose.heading))

    def news(self) -> str:
        """What the live bridge would report as wrong; "" where it was said before."""
        before, self._said = self._said, self.health.last_error
        return self._said if self._said != before else ""

    def _fail(self, text: str) -> None:
        self.trouble = self.trouble or text
        self.stopping.set()


class _Listener:
    """Receives the robot's corrections from the bus, and a ROS 2 robot's odometry."""

    def __init__(self, session: _Session, bus: Bus, say: Say) -> None:
        self._session, self._bus, self._say = session, bus, say
        self._samples = subscribed(bus, session.site, session.robot)
        self._corrections = Corrections(
            session.site, session.bridge, session.health, session.clock, self._would_send
        )
        self._odometry: list[Subscription] = []
        if session.config.protocol_name == ROS2_PROTOCOL:
            topic = ros_topic(session.site, session.robot)
            self._odometry = [bus.subscribe(FOREIGN, key) for key in foreign_keys(topic)]

    def listen(self) -> None:
        """Take in everything that arrived since the last call."""
        for samples in self._odometry:
            while (sample := samples.take(0.0)) is not None:
                session = self._session
                try:
                    events = reading_of(sample, session.bridge, session.health, session.clock)
                except MessageError as reason:
                    session.health.reject(sample, reason)
                    continue
                for event in events:
                    self._session.handle(event)
        while (sample := self._samples.take(0.0)) is not None:
            self._corrections.take(sample)
        if self._session.bridge.asks_for_map:
            ask_for_map(
                self._bus, self._session.site.name, self._session.bridge, self._session.clock
            )

    def _would_send(self, correction: RobotCorrection) -> None:
        x, y, _ = (float(value) for value in correction.map_from_base.translation)
        sigmas = np.sqrt(np.diag(correction.covariance)[[0, 1, 5]])
        verb = "send" if self._session.traits.takes is Takes.CORRECTIONS else "take up"
        anew = ", which places it anew" if correction.establishes else ""
        self._say(
            f"would {verb} a correction{anew}: x {x:.3f} m, y {y:.3f} m, heading "
            f"{float(correction.map_from_base.heading):.3f} rad, sigmas {sigmas[0]:.4f} m, "
            f"{sigmas[1]:.4f} m, {sigmas[2]:.4f} rad"
        )


def look(
    site: Site,
    robot: str,
    say: Say,
    *,
    open_bus: Callable[[Site], Bus],
    seconds: float = SECONDS,
    clock: Clock | None = None,
) -> None:
    """Report each second what the robot sends and what it would be sent; raise OperationError if it
    does not work."""
    clock = clock or SystemClock()
    session = _Session(site, robot, clock)
    _say_begin(session, say)
    with ExitStack() as stack:
        listener = _listener(session, say, stack, open_bus)
        stack.enter_context(session.running())
        end_ns = clock.elapsed_ns() + to_ns(seconds)
        is_greeted, before, said_ns = False, 0, clock.elapsed_ns()
        while clock.elapsed_ns() < end_ns and not clock.wait(session.stopping, _SLICE_S):
            if listener is not None:
                listener.listen()
            who = session.bridge.connected
            if who is not None and not is_greeted:
                is_greeted = True
                say(f"robot «{who.robot}», firmware «{who.firmware}», boot {who.boot}")
            if clock.elapsed_ns() >= said_ns + to_ns(1.0):
                said_ns += to_ns(1.0)
                before = _say_second(session, say, before)
    if session.trouble:
        raise OperationError(session.trouble)
    if not session.health.total("odometry"):
        raise OperationError(_why_nothing(session))
    _say_end(session, say)


def _say_begin(session: _Session, say: Say) -> None:
    config = session.config
    if config.protocol_name == ROS2_PROTOCOL:
        topic = ros_topic(session.site, session.robot)
        say(f"robot on the bus; odometry is looked for on {' and '.join(foreign_keys(topic))}")
    else:
        say(f"port {port_url(session.site, session.robot)} is open at {config.baud} baud")
    for lack in session.traits.lacks:
        say(f"note: {lack}")


def _listener(
    session: _Session, say: Say, stack: ExitStack, open_bus: Callable[[Site], Bus]
) -> _Listener | None:
    """None if the bus cannot be opened: a serial robot can be examined without it."""
    try:
        return _Listener(session, stack.enter_context(open_bus(session.site)), say)
    except BusError as reason:
        if session.config.protocol_name == ROS2_PROTOCOL:
            raise
        say(f"note: without the bus no corrections come ({reason})")
        return None


def _say_second(session: _Session, say: Say, before: int) -> int:
    total, health = session.health.total("odometry"), session.health
    glance = Glance(
        total - before,
        *session.pose,
        session.bridge.clock.round_trip_us,
        session.bridge.clock.drift_ppm,
        health.lost("serial_frames_missing"),
        sum(health.lost(name) for name in _TROUBLE),
    )
    say(str(glance))
    if news := session.news():
        say(f"     {news}")
    if health.total("corrections"):
        say(f"     corrections: {health.total('corrections')} came; place {session.bridge.state}")
    return total


def _say_end(session: _Session, say: Say) -> None:
    """What was not used, or not as it came, though other odometry was."""
    for lack in Mended:
        if count := session.health.total(mended_count(lack)):
            say(f"note: {counted(count, 'odometry message')} {lack}")
    if unused := _unused(session):
        say(f"note: {unused}")


def _unused(session: _Session) -> str:
    """How much odometry could not be used, and why the last of it; "" where there is none."""
    health = session.health
    count = health.total("rejected") + sum(health.lost(name) for name in _UNUSED)
    if not count:
        return ""
    return f"{counted(count, 'odometry message')} could not be used; the last: {health.last_error}"


def _why_nothing(session: _Session) -> str:
    robot = session.robot
    if unused := _unused(session):
        return unused
    if session.config.protocol_name == ROS2_PROTOCOL:
        return (
            f"no odometry of robot {robot} comes on the bus; does its bridge run as a client of "
            "this site (docs/how-to/ros2.md), and is `topic` right?"
        )
    assert session.line is not None  # every other robot is at a port
    return why_nothing(robot, session.config.protocol_name, session.line, session.bridge)
