"""The table of situations: each is a world, what is wrong in it, and what the site file says."""

from collections.abc import Mapping
from enum import Enum
from typing import Literal

import numpy as np
from msgspec import Struct, field

from trigpoint.tools.simulation.motion.actors import Lift, Move

from .disturbance import Disturbance, LensSpread


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
    world: str = "drive"
    goal: Goal = HARDER
    target: Literal["charuco", "checkerboard"] | None = None
    disturbance: Disturbance = field(default_factory=Disturbance)
    camera: Mapping[str, object] = field(default_factory=dict)
    odometry: Mapping[str, float] = field(default_factory=dict)
    fusion: Mapping[str, object] = field(default_factory=dict)
    is_lens_nominal: bool = False
    is_in_order: bool = True
    known: Known = Known.NONE


NEW_CAMERA = "c5"
MOVED_CAMERA = "c5"

_LENS = LensSpread(focal=0.05, centre=0.02, distortion=0.05)
_LENS_KEYS = {
    "intrinsics": "estimate",
    "focal_sigma": _LENS.focal,
    "centre_sigma": _LENS.centre,
    "distortion_sigma": _LENS.distortion,
}
# Along its wall, which is the map's y axis, and turned: what a broom does to a camera. c2 is met
# again after that.
_KNOCK = np.array([0.0, 0.15, -0.05, 0.03, -0.02, 0.14])

SITUATIONS: dict[str, Situation] = {
    "drive": Situation("a drive without a stop, 0.4 m/s, 5 Hz", goal=PLAIN),
    "drive_10hz": Situation("the same, 10 Hz", "drive_10hz", PLAIN),
    "one_picture": Situation(
        "one picture a camera and pass on a closed loop",
        "one_picture",
        PLAIN,
    ),
    "dance": Situation("the dance", "dance", PLAIN),
    "loop": Situation("loops in the dance's time", "loop", PLAIN),
    "alike": Situation("six equal checkerboards", target="checkerboard"),
    "lens": Situation(
        "unknown lenses, drawn about the nominal one",
        disturbance=Disturbance(lens=_LENS),
        camera=_LENS_KEYS,
    ),
    "nominal_lens": Situation(
        "unknown lenses, the site file's defaults",
        camera={"intrinsics": "estimate"},
        is_lens_nominal=True,
    ),
    "displaced": Situation(
        "5 % of the sightings displaced by 15 px",
        disturbance=Disturbance(displaced_share=0.05),
    ),
    "wild": Situation(
        "1 % of the corners wild",
        disturbance=Disturbance(wild_share=0.01),
    ),
    "misnamed": Situation(
        "2 % of the sightings named as another face",
        disturbance=Disturbance(misnamed_share=0.02),
    ),
    "time_offset": Situation(
        "unknown time offsets of 50 ms",
        disturbance=Disturbance(time_offset_s=0.05),
        camera={"time_offset_sigma": 0.05},
    ),
    "rolling": Situation(
        "rolling shutters of 30 µs a row",
        disturbance=Disturbance(line_delay_s=30e-6),
        camera={"line_delay": 30e-6},
    ),
    "scale": Situation(
        "unknown odometry scale errors of 2 %",
        odometry={"distance_scale": 0.02, "heading_scale": 0.02},
    ),
    "mount": Situation(
        "faces mounted 3 mm and 0.5° off",
        disturbance=Disturbance(mount_m=0.003, mount_rad=float(np.radians(0.5))),
        fusion={"target_translation": 0.003, "target_rotation": float(np.radians(0.5))},
    ),
    "new_camera": Situation("a known network and a new camera", known=Known.ALL_BUT_ONE),
    "moved_since": Situation(
        "a known network of which a camera was moved",
        disturbance=Disturbance(moves={MOVED_CAMERA: (Move(-1.0, _KNOCK),)}),
        known=Known.ONE_MOVED,
    ),
    "two_robots": Situation("two robots that meet only cameras", "two_robots", PLAIN),
    "robots_alike": Situation("two robots that carry one target", "robots_alike"),
    "moved": Situation(
        "a camera moved in mid-session",
        disturbance=Disturbance(moves={"c2": (Move(35.0, _KNOCK),)}),
    ),
    "revisit": Situation("a revisit after long drift", "long_way", PLAIN),
    "kidnapped": Situation(
        "a robot lifted and put down elsewhere",
        disturbance=Disturbance(lifts={"r1": (Lift(25.0, 7.0),)}),
    ),
    "kidnapped_known": Situation(
        "a robot lifted on its second lap, then past cameras of the first",
        "two_laps",
        disturbance=Disturbance(lifts={"r1": (Lift(82.0, 7.0),)}),
    ),
    "seen_once": Situation(
        "a camera seen once, a camera never seen",
        goal=PLAIN,
        disturbance=Disturbance(pictures={"c3": 1, "c4": 0}),
    ),
    "disorder": Situation(
        "sightings late, twice and out of order, odometry gaps",
        disturbance=Disturbance(
            twice_share=0.1, late_share=0.2, gaps_s=((20.0, 22.5), (39.0, 40.5))
        ),
        is_in_order=False,
    ),
}
