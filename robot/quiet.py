"""Why no odometry comes from a robot at a port, in the same words live and in a dry run."""

from typing import Protocol

from trigpoint.clock import to_ns
from trigpoint.health import Health

from .bridge import Bridge

_PATIENCE_NS = to_ns(5.0)


class Heard(Protocol):
    """What is looked at of a port; `Line` implements it."""

    @property
    def is_open(self) -> bool: ...

    @property
    def last_line(self) -> str: ...


def why_nothing(robot: str, protocol: str, line: Heard, bridge: Bridge) -> str:
    """What is wrong where the port is open but no odometry comes, and what to do."""
    if bridge.complaint:
        return bridge.complaint
    if bridge.connected is not None:
        return f"robot {robot} answers but sends no odometry; look at its firmware"
    if line.last_line:
        return (
            f"what comes from robot {robot} is not understood as «{protocol}»; the last that came: "
            f"«{line.last_line}»; compare `protocol` and `baud` with the firmware's"
        )
    return f"nothing comes from robot {robot}; is it on, and is `port` the right one?"


class OdometryWatch:
    """Says now and then in the health that an open port brings no odometry. One thread."""

    def __init__(
        self, robot: str, protocol: str, line: Heard, bridge: Bridge, health: Health
    ) -> None:
        self._robot, self._protocol = robot, protocol
        self._line, self._bridge, self._health = line, bridge, health
        self._readings, self._since_ns = 0, 0

    def look(self, now_ns: int) -> None:
        """Call it once a second."""
        readings = self._health.total("odometry")
        if readings != self._readings or not self._line.is_open or not self._since_ns:
            self._readings, self._since_ns = readings, now_ns
        elif now_ns - self._since_ns >= _PATIENCE_NS:
            self._since_ns = now_ns
            why = why_nothing(self._robot, self._protocol, self._line, self._bridge)
            self._health.fail(why)
