"""`[map]`: where the map lies in the building."""

import math

from msgspec import Struct

from .names import validate_name
from .number_types import NotNegative, Positive


class PointConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """One surveyed point: a camera's optical centre, or a mark on the floor that a robot stood on.

    `position`: x, y and, where it was surveyed, z, metres; or `pixel`: column and row in the plan.
    """

    position: tuple[float, ...] | None = None
    pixel: tuple[float, float] | None = None
    sigma: Positive = 0.01
    robot: str | None = None
    at: NotNegative = 0.0

    def __post_init__(self) -> None:
        if (self.position is None) == (self.pixel is None):
            raise ValueError("a point has either `position` (m) or `pixel` (of the plan); give one")
        if self.position is not None and len(self.position) not in (2, 3):
            raise ValueError(
                f"`position` has {len(self.position)} numbers; write [x, y] or [x, y, z]"
            )
        if not all(math.isfinite(value) for value in (self.position or self.pixel or ())):
            raise ValueError("`position` and `pixel` are finite numbers; correct them")


class MapConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the map lies in the building: by surveyed points, or by its origin alone."""

    frame: str = "building"
    level: bool = True
    origin: tuple[float, float, float] | None = None
    plan: str | None = None
    points: dict[str, PointConfig] = {}

    def __post_init__(self) -> None:
        validate_name("frame", self.frame)
        if self.frame == "map":
            raise ValueError("`map` is the frame that is aligned; call the building's otherwise")
        if self.points and self.origin is not None:
            raise ValueError("`origin` and [map.points] say the same twice; take one of them out")
        if not (self.points or self.plan or self.origin):
            raise ValueError("[map] says nothing; give points, an origin or a plan")
        for name, point in self.points.items():
            if point.pixel is not None and self.plan is None:
                raise ValueError(f"points.{name} is a pixel of no plan; give `plan` too")
            if not self.level and len(point.position or ()) != 3:
                raise ValueError(f"points.{name} has no z, which level = false needs; give it")
