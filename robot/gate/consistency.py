"""A run of corrections that agree with each other, but are not yet confirmed otherwise."""

from uuid import UUID

import numpy as np
from msgspec import Struct

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.geometry import Pose
from trigpoint.geometry.pose import angle_between
from trigpoint.geometry.rotation import Array
from trigpoint.robot.odometry.recent import OdometryHistory
from trigpoint.site.config import RobotConfig

from .map_placement import Measured, Placement

# This many in a row, over at least this time: at 10 Hz one camera's glimpse of a passing robot.
AGREEING = 10
AGREEING_NS = to_ns(1.0)


class Agreement:
    """Corrections in one map; `began_ns`: arrival of the first, Unix time."""

    def __init__(self, first: Measured, map_id: UUID, began_ns: int, config: RobotConfig) -> None:
        self.map_id, self.began_ns = map_id, began_ns
        self.placement = Placement(first, config)
        self.count = 1
        self._motion = config.safety.establish_motion
        self._begin_ns = first.at.stamp_ns
        self._begin: Pose = first.at.odom_from_base
        self._moved = 0.0

    def goes_on_with(self, measured: Measured, map_id: UUID, history: OdometryHistory) -> bool:
        """Whether a correction is in this map and agrees with the earlier ones."""
        return map_id == self.map_id and not self.placement.contradiction(measured, history)

    def take(self, measured: Measured, history: OdometryHistory) -> tuple[Pose, Array]:
        """Add a correction that agrees; return the pose and covariance of all combined."""
        self.count += 1
        here = measured.at.odom_from_base
        away = float(np.linalg.norm(here.translation - self._begin.translation))
        turned = float(angle_between(self._begin, here))
        self._moved = max(self._moved, away, turned)
        return self.placement.take(measured, history)

    @property
    def is_complete(self) -> bool:
        """Whether there are enough, over enough time and from more than one place."""
        return self._is_long and self._moved >= self._motion

    @property
    def _is_long(self) -> bool:
        return self.count >= AGREEING and self._lasts_ns >= AGREEING_NS

    @property
    def _lasts_ns(self) -> int:
        return self.placement.newest_ns - self._begin_ns

    def progress(self, word: "MapWord") -> str:
        """What has been seen and what is still missing, in words for people."""
        text = f"{self.count} agree over {to_seconds(self._lasts_ns):.1f} s"
        if not self._is_long:
            return f"{text}, {AGREEING} over {to_seconds(AGREEING_NS):.0f} s are needed"
        if not self.is_complete:
            return (
                f"{text}, all from one place: drive or turn the robot by {self._motion:g} m or rad"
            )
        return f"{text}; {word.about(self)}"


class MapWord(Struct):
    """Fusion's last answer to what its map is (`fusion/map`)."""

    _maps: frozenset[UUID] = frozenset()
    _heard_ns: int | None = None

    def hear(self, maps: list[UUID], now_ns: int) -> None:
        """Take in the answers of all who serve the command; empty if nobody answered."""
        self._maps, self._heard_ns = frozenset(maps), now_ns

    def speaks_for(self, run: Agreement) -> bool:
        """Whether fusion named this map, alone, since the run began."""
        is_fresh = self._heard_ns is not None and self._heard_ns >= run.began_ns
        return is_fresh and self._maps == {run.map_id}

    def about(self, run: Agreement) -> str:
        """How fusion's answer relates to a run, in words for people."""
        if self.speaks_for(run):
            return "fusion says that this is its map"
        if not self._maps:
            return "fusion does not answer what its map is (fusion/map)"
        names = " and ".join(sorted(str(map_id) for map_id in self._maps))
        return f"fusion says that its map is {names}"
