"""The result of data association: what is taken to have happened in a session, as plain values."""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.dataset import CameraMove, Lift
from trigpoint.fusion.model.observations import Observation, Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .noise import Noise


class Alternative(Struct, frozen=True):
    """One place where a camera may be. `covariance` (6, 6): of the pose; `probability`: its share
    of the posterior; `spread` (6, 6): the second moment, about this pose, of the poses of all
    explanations that count as this place."""

    map_from_camera: Pose
    covariance: Array
    probability: float
    spread: Array


class CameraFinding(Struct, frozen=True):
    """Where one camera is at the end of the session. `alternatives`: the fewest places that
    together hold all but the level of evidence of the posterior, best first; `reason`: why the
    camera is not located, in words; empty if it is."""

    alternatives: tuple[Alternative, ...]
    reason: str = ""

    @property
    def is_located(self) -> bool:
        return not self.reason and len(self.alternatives) == 1


class Read(Struct, frozen=True):
    """How one observation is read. `readings`: one for each view, None for a wrong one; `wild`:
    which corners of each view are wild; `map_from_base`: where the robot stood, None if unknown;
    `place`: the number of the camera's place."""

    readings: tuple[Reading | None, ...]
    wild: tuple[np.ndarray, ...]
    map_from_base: Pose | None
    place: int


class Explanation(Struct, frozen=True):
    """The likeliest explanation of a session, with the alternatives that remain open.

    `observations`: in the order given, their corners' noise as learnt; `reads`: one for each;
    `findings`: by camera; `places`: by (camera, number of its place), the camera there, if that
    place is determined without alternatives; `lifts`: for each lift, all that explain the session
    nearly as well, the likeliest first; `noise`: by robot; `corner_scale`: by camera, how many
    times as much as stated its corners scatter.
    """

    observations: tuple[Observation, ...]
    reads: tuple[Read, ...]
    findings: dict[str, CameraFinding]
    places: dict[tuple[str, int], CameraState]
    lifts: tuple[tuple[Lift, ...], ...]
    moves: tuple[CameraMove, ...]
    noise: dict[str, Noise]
    corner_scale: dict[str, float]
