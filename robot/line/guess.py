"""Finds out by asking which protocol a robot at a port speaks.

Each protocol's own first words are harmless: who is there, what does the clock read, what do the
encoders count. Whoever answers in a protocol's own frames speaks it. A robot that is moving goes on
moving; iRobot's stays in passive mode.
"""

import time

from msgspec import Struct

from trigpoint.base.clock import to_ns
from trigpoint.base.errors import PortError, TrigpointError
from trigpoint.site.config import MavlinkConfig, RobotConfig, WheelConfig

from .port import Port
from .protocol import Connected, Mismatched, Setup, make_protocol

# Protocols with their most common speed. Those that send unasked come first.
CANDIDATES = (
    ("trigpoint", 115200),
    ("mavlink", 57600),
    ("mavlink", 115200),
    ("create2", 115200),
    ("ros_arduino_bridge", 57600),
)
# Longer than the second between two heartbeats. A board that restarts as its port is opened takes
# as long again, but then answers to the next candidate's question.
LISTEN_S = 1.3


class Guess(Struct, frozen=True):
    """What somebody at a port answered in; `who` is what it says of itself."""

    protocol: str
    baud: int
    who: str


def guessed(url: str, *, listen_s: float = LISTEN_S) -> Guess | None:
    """The first protocol in which the robot answers; None if there is none. Raises PortError if the
    port does not open."""
    for protocol, baud in CANDIDATES:
        with Port(url, baud) as port:
            who = _answer(port, protocol, baud, listen_s)
        if who is not None:
            return Guess(protocol, baud, who)
    return None


def _answer(port: Port, name: str, baud: int, listen_s: float) -> str | None:
    wheels = WheelConfig(diameter=1.0, track=1.0, ticks=1.0)  # any values: nothing is driven
    config = RobotConfig(
        port=port.url, baud=baud, protocol=name, wheels=wheels, mavlink=MavlinkConfig()
    )
    try:
        protocol = make_protocol(Setup("guess", config, 0, time.time_ns()))
    except TrigpointError:
        return None  # its extra is not installed here
    end_ns = time.monotonic_ns() + to_ns(listen_s)
    while (now_ns := time.monotonic_ns()) < end_ns:
        try:
            if protocol.due_ns(now_ns) <= now_ns:
                port.write(protocol.data_to_send(now_ns))
            data, received_ns = port.read()
        except PortError:
            return None
        for event in [*protocol.elapse(received_ns), *protocol.receive(data, received_ns)]:
            match event:
                case Connected():
                    return event.firmware
                case Mismatched():
                    return event.text  # it speaks the protocol, but gives another robot's name
    return None
