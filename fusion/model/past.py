"""What a map keeps of a past whose sightings it does not keep: information and counts.

What is settled is summarised as the joint distribution of cameras and of what is known along with
them, after the robots' poses are eliminated: that loses nothing as long as the point about which it
is linearised is near. What nobody can look at again is left as it was concluded.
"""

from collections.abc import Mapping

from msgspec import Struct, field

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import CameraModel
from trigpoint.map.network import EarlierPose

from .known_cameras import KnownCameras

ODOMETRY_BEFORE_NS = 2 * NANOSECONDS
"""By its camera's clock a sighting may be older than by its robot's: so much odometry from before
those that are kept is kept too."""


class PastCamera(Struct, frozen=True):
    """Of one camera: its sightings (faces) that are not kept and how many of them were used; and
    where it hung before it was moved, the oldest first."""

    sightings: int = 0
    used: int = 0
    earlier: tuple[EarlierPose, ...] = ()


class Past(Struct, frozen=True):
    """`known`: what the sightings told that are not kept; `since_ns`: by robot, the stamp from
    which on its sightings are; `map_since_ns`: the stamp of the first robot's first odometry
    message, None where none came; `epoch_ns`: the reference time of the clocks' drift; `lenses`: by
    camera, known or the initial value of its estimation."""

    known: KnownCameras
    since_ns: Mapping[str, int]
    map_since_ns: int | None
    epoch_ns: int
    lenses: Mapping[str, CameraModel]
    cameras: Mapping[str, PastCamera] = field(default_factory=dict)

    @property
    def begin_ns(self) -> int:
        """Before then no sighting is kept."""
        return min(self.since_ns.values(), default=0)

    @property
    def end_ns(self) -> int:
        """From then on every sighting is kept."""
        return max(self.since_ns.values(), default=0)

    def is_over(self, robot: str, stamp_ns: int) -> bool:
        """Whether a sighting of a robot is part of the past, known or lost."""
        return stamp_ns < self.since_ns.get(robot, 0)

    def odometry_since_ns(self, robot: str) -> int:
        """From then on a robot's odometry bears on sightings that are kept."""
        return self.since_ns.get(robot, 0) - ODOMETRY_BEFORE_NS
