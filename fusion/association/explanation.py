"""What is taken to have happened in a session: the outcome of data association, a value."""

from dataclasses import dataclass

import numpy as np

from trigpoint.fusion.model.dataset import CameraMove, Lift
from trigpoint.fusion.model.observations import Observation, Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .noise import Noise


@dataclass(frozen=True, slots=True)
class Alternative:
    """A place that is left open: `covariance` (6, 6), and the share of the posterior; `spread`
    (6, 6): how far explanations that put the camera here put it from one another."""

    map_from_camera: Pose
    covariance: Array
    probability: float
    spread: Array


@dataclass(frozen=True, slots=True)
class CameraFinding:
    """Where one camera is, at last. `alternatives`: every place that holds more of the posterior
    than the level of evidence, best first; `reason`: in words, where there is not one place."""

    alternatives: tuple[Alternative, ...]
    reason: str = ""

    @property
    def is_located(self) -> bool:
        return not self.reason and len(self.alternatives) == 1


@dataclass(frozen=True, slots=True)
class Read:
    """How one observation is read: a reading for each view, None where it is wrong; the wild
    corners of each; where the robot stood, None where nothing says; the number of its camera's
    place."""

    readings: tuple[Reading | None, ...]
    wild: tuple[np.ndarray, ...]
    map_from_base: Pose | None
    place: int


@dataclass(frozen=True, slots=True)
class Explanation:
    """The likeliest explanation, with what is open beside it.

    `observations`: as they came, with their corners' noise as learnt, `corner_scale` by camera as
    much as stated; `reads`: one for each;
    `findings`: by camera; `places`: by (camera, number of its place) where it was, those that are
    one place; `lifts`: for each those that explain it alike, the likeliest first.
    """

    observations: tuple[Observation, ...]
    reads: tuple[Read, ...]
    findings: dict[str, CameraFinding]
    places: dict[tuple[str, int], CameraState]
    lifts: tuple[tuple[Lift, ...], ...]
    moves: tuple[CameraMove, ...]
    noise: dict[str, Noise]
    corner_scale: dict[str, float]
