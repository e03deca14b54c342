"""A serial protocol of one's own: lines «x y heading» in metres and radians, as often as they come.

Say so in your package's pyproject.toml, and any site file may have `protocol = "lines"`:

    [project.entry-points."trigpoint.protocols"]
    lines = "serial_protocol:Lines"
"""

import numpy as np

from trigpoint import Pose, plugins

SILENCE_NS = 1_000_000_000


class Lines:
    """The conversation with one robot: bytes in, events out; it reads no clock and no port."""

    traits = plugins.Traits(
        plugins.Takes.NOTHING, plugins.StampClock.MACHINE, ("corrections: it only speaks",)
    )

    def __init__(self, setup: plugins.Setup) -> None:
        self._robot = setup.robot
        self.reset()

    def reset(self) -> None:
        self._rest, self._heard_ns = b"", 0

    def receive(self, data: bytes, now_ns: int) -> list[plugins.Event]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-200:]
        return [event for line in lines for event in self._events(line, now_ns)]

    def _events(self, line: bytes, now_ns: int) -> list[plugins.Event]:
        try:
            x, y, heading = (float(word) for word in line.split())
        except ValueError:
            return [plugins.Damaged(plugins.DamageKind.CONTENT)]
        is_new, self._heard_ns = self._heard_ns == 0, now_ns
        pose, unknown = Pose.planar(x, y, heading), np.zeros(3)  # it says no velocities
        reading = plugins.Reading(now_ns, now_ns, pose, unknown, unknown)
        return [plugins.Connected(self._robot, "lines", 0), reading] if is_new else [reading]

    def elapse(self, now_ns: int) -> list[plugins.Event]:
        if self._heard_ns == 0 or now_ns - self._heard_ns < SILENCE_NS:
            return []
        self._heard_ns = 0
        return [plugins.Silent()]

    def data_to_send(self, now_ns: int) -> bytes:
        return b""

    def due_ns(self, now_ns: int) -> int:
        return now_ns + SILENCE_NS

    def correct(self, correction: plugins.RobotCorrection) -> None:
        raise NotImplementedError("it takes no corrections, as its traits say")

    def locate(self, pose: plugins.LocatedPose) -> None:
        raise NotImplementedError("it takes no poses, as its traits say")
