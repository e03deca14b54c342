"""What makes a situation: a world, what is wrong in it, and what the site file says of it."""

from collections.abc import Mapping
from enum import Enum
from typing import Literal

from msgspec import Struct, field

from .disturbance import Disturbance


class Known(Enum):
    """Which cameras are known from an earlier network."""

    NONE = "none"
    ALL_BUT_ONE = "all but a new one"
    ONE_MOVED = "all, but one hangs elsewhere by now"


class Goal(Struct, frozen=True):
    """`efficiency` at most, `honesty` between these."""

    efficiency: float
    honesty: tuple[float, float]


PLAIN = Goal(1.03, (0.95, 1.05))
HARDER = Goal(1.10, (0.9, 1.1))


class Situation(Struct, frozen=True):
    """`title`: in a table. `world`: of the table in `worlds`. `target`: what all robots
    carry, if not what the world says.

    What the site file says: `camera`, `odometry` and `fusion`: keys of every camera, of every
    robot's odometry, of fusion. `is_lens_nominal`: the cameras' lenses are told as the site file's
    nominal one and not as the world's. `is_in_order`: messages are pushed in the order of their
    stamps, as `calibrate` does it, and not as they come.
    """

    title: str
    world: str
    goal: Goal = HARDER
    target: Literal["charuco", "checkerboard"] | None = None
    disturbance: Disturbance = field(default_factory=Disturbance)
    camera: Mapping[str, object] = field(default_factory=dict)
    odometry: Mapping[str, float] = field(default_factory=dict)
    fusion: Mapping[str, object] = field(default_factory=dict)
    is_lens_nominal: bool = False
    is_in_order: bool = True
    known: Known = Known.NONE
