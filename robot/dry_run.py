"""What `--dry-run` does: talk to the robot for a few seconds and say what came; no bus."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from trigpoint.clock import Clock, SystemClock, to_ns
from trigpoint.config import Site
from trigpoint.errors import OperationError
from trigpoint.health import Health

from .bridge import Bridge
from .line import Line
from .node import port_url, protocol_setup
from .offset import measured_offset
from .port import PortOpener
from .protocol import Event, Mismatched, make_protocol

SECONDS = 5.0
_TROUBLE = ("serial_framing_errors", "serial_checksum_errors", "serial_content_errors")


@dataclass(frozen=True, slots=True)
class Glance:
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
    """The threads and what they saw."""

    def __init__(self, site: Site, robot: str, clock: Clock) -> None:
        config, url = site.robot(robot), port_url(site, robot)
        self.health = Health(clock)
        protocol = make_protocol(protocol_setup(site, robot, clock))
        offset = measured_offset(clock)
        self.bridge = Bridge(robot, config, self.health, offset, protocol.traits)
        self.stopping = threading.Event()
        self.trouble = ""
        self.pose = (0.0, 0.0, 0.0)
        PortOpener(url, config.baud).open().close()  # raises at once where it cannot be opened
        self._line = Line(
            PortOpener(url, config.baud).open,
            protocol,
            clock=clock,
            handle=self._handle,
            failed=self._fail,
        )

    @contextmanager
    def running(self) -> Iterator[None]:
        runs = (self._line.read_until, self._line.write_until)
        threads = [threading.Thread(target=run, args=(self.stopping,)) for run in runs]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self.stopping.set()
            for thread in threads:
                thread.join()

    def _handle(self, event: Event) -> None:
        if isinstance(event, Mismatched):
            self._fail(event.text)
        odometry = self.bridge.on_event(event)
        if odometry is not None:
            x, y, _ = (float(value) for value in odometry.pose.translation)
            self.pose = (x, y, float(odometry.pose.heading))

    def _fail(self, text: str) -> None:
        self.trouble = self.trouble or text
        self.stopping.set()


def look(
    site: Site,
    robot: str,
    say: Callable[[str], None],
    *,
    seconds: float = SECONDS,
    clock: Clock | None = None,
) -> None:
    """Say each second what the robot sends; raise OperationError where it does not work."""
    clock = clock or SystemClock()
    session = _Session(site, robot, clock)
    say(f"port {port_url(site, robot)} is open at {site.robot(robot).baud} baud")
    with session.running():
        end_ns = clock.elapsed_ns() + to_ns(seconds)
        is_greeted, before = False, 0
        while clock.elapsed_ns() < end_ns and not clock.wait(session.stopping, 1.0):
            who = session.bridge.connected
            if who is not None and not is_greeted:
                is_greeted = True
                say(f"robot «{who.robot}», firmware «{who.firmware}», boot {who.boot}")
            before = _say_second(session, say, before)
    if session.trouble:
        raise OperationError(session.trouble)
    if not session.health.total("odometry"):
        raise OperationError(_why_nothing(session, robot))


def _say_second(session: _Session, say: Callable[[str], None], before: int) -> int:
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
    return total


def _why_nothing(session: _Session, robot: str) -> str:
    if session.bridge.connected is not None:
        return f"robot {robot} answers but sends no odometry; look at its firmware"
    if sum(session.health.lost(name) for name in _TROUBLE):
        return f"only garbage comes from robot {robot}; compare `baud` with the firmware's"
    return f"nothing comes from robot {robot}; is it on, and is `port` the right one?"
