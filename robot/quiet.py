"""What a bridge says of things that do not come: odometry, in the same words live and in a dry run,
and corrections."""

import logging
import math
import re
import textwrap
from typing import Protocol

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.base.words import plus_minus
from trigpoint.node.clock_watch import CLOCK_IS_OFF
from trigpoint.node.health import Health

from .bridge import Bridge

_log = logging.getLogger(__name__)

_PATIENCE_NS = to_ns(5.0)
# Longer than a robot takes from one camera to the next in a building where they are worth hanging.
_UNCORRECTED_NS = to_ns(10.0)
_AWAY = "fusion is not running any more"
_UNSEEN = "no located camera sees it"
_MOST_SAID = 200
# Fusion's diagnostics come once a second.
_FUSION_AWAY_S = 5.0


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


class Listening(Protocol):
    """What is needed of a node; `Node` implements it."""

    health: Health

    def silent_s(self, server: str) -> float | None: ...

    def trouble_of(self, server: str) -> str: ...


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


class CorrectionWatch:
    """Puts into a bridge's health where the robot is, and that it is not corrected: `key` brings
    no corrections, or none that are taken. One thread."""

    def __init__(self, robot: str, bridge: Bridge, node: Listening, key: str) -> None:
        self._robot, self._bridge, self._node, self._key = robot, bridge, node, key
        self._taken = self._received = 0
        self._taken_ns = self._received_ns = 0
        self._told = ""

    def look(self, now_ns: int) -> None:
        """Call it once a second."""
        health = self._node.health
        taken, received = (
            health.total("corrections_accepted"),
            health.total(f"received {self._key}"),
        )
        if taken != self._taken or not self._taken_ns:
            self._taken, self._taken_ns = taken, now_ns
        if received != self._received or not self._received_ns:
            self._received, self._received_ns = received, now_ns
        self._tell(now_ns - self._taken_ns, now_ns - self._received_ns)
        self._show_place(now_ns - self._taken_ns)

    def _tell(self, age_ns: int, received_age_ns: int) -> None:
        health = self._node.health
        if age_ns < _UNCORRECTED_NS:
            self._told = ""
            health.release("corrections")
            health.describe("uncorrected", "")
            return
        if self._received and received_age_ns < _UNCORRECTED_NS:
            kind, why = "not taken", self._why_not_taken()
        else:
            kind = self._why_none_comes()
            why = kind + self._fusion_says() if kind == _UNSEEN else kind
        text = (
            f"no corrections for {to_seconds(age_ns):.0f} s: {why}; robot {self._robot} goes on by "
            "its own odometry alone, whose error grows"
        )
        if kind == _AWAY:
            health.describe("uncorrected", "")
            health.hold("corrections", text)
            return
        health.release("corrections")
        health.describe("uncorrected", text)
        if kind != self._told:
            self._told = kind
            _log.info("%s", text)

    def _why_not_taken(self) -> str:
        return (
            self._node.health.held.get(CLOCK_IS_OFF)
            or self._bridge.refusal
            or "the first is being judged"
        )

    def _why_none_comes(self) -> str:
        away_s = self._node.silent_s("fusion")
        if away_s is None:
            return "fusion was never heard"
        return _AWAY if away_s > _FUSION_AWAY_S else _UNSEEN

    def _fusion_says(self) -> str:
        """What of fusion's trouble may be why: what names this robot, corrections, or a hang."""
        name = re.escape(self._robot)
        concerns = re.compile(rf"\b({name}|corrections|no sign of life)\b")
        parts = self._node.trouble_of("fusion").split("; ")
        said = "; ".join(part for part in parts if concerns.search(part))
        return said and f"; fusion says: {textwrap.shorten(said, _MOST_SAID, placeholder=' …')}"

    def _show_place(self, age_ns: int) -> None:
        place = self._bridge.place()
        words = ""
        if place is not None:
            pose, covariance = place
            x, y, _ = pose.translation
            sigma_m = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
            words = (
                f"x {x:.2f} m, y {y:.2f} m, heading {math.degrees(pose.heading):.0f}°, "
                f"{plus_minus(sigma_m)}, ±{math.degrees(math.sqrt(covariance[5, 5])):.1f}°; "
                f"corrected {to_seconds(age_ns):.0f} s ago"
            )
        self._node.health.describe("place", words)
