"""A mode of one visit: a pose of its camera that the visit allows, and all that goes with it."""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.observations import Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians

from .visits import Visit


class Mode(Struct, frozen=True):
    """One local optimum of a visit's posterior: a pose of the camera and all that goes with it.

    `map_from_camera`: in the frame in which odometry puts the robot (the robot's pose in the first
    picture is exactly odometry's at that picture's stamp); `camera`: with lens and clock;
    `information`: of the camera's own unknowns, pose (6), then lens and clock where they are
    estimated, their priors included; `score`: with all other unknowns integrated out; `evidence`:
    with the camera's own too; `readings`: by index, None for a wrong sighting; `wild`: by
    index, each view's wild corners; `poses`: by index, where the robot stood; `poses_covariance`
    (m, d, m, d): of these at the m chosen pictures, each `early_s` before its stamp; `scales`: (2,)
    and their covariance, and `faces`: base_from_face of all faces, each where it is estimated.
    """

    camera: CameraState
    information: Array
    score: float
    evidence: float
    readings: dict[int, tuple[Reading | None, ...]]
    wild: dict[int, tuple[np.ndarray, ...]]
    poses: dict[int, Pose]
    poses_covariance: Array
    early_s: float = 0.0
    scales: tuple[Array, Array] | None = None
    faces: Pose | None = None

    @property
    def map_from_camera(self) -> Pose:
        return self.camera.map_from_camera

    def moved(self, earlier: int, later: int, tangent: list[int]) -> tuple[Pose, Array]:
        """The robot's motion between two chosen pictures, and its covariance (d, d) in the free
        directions `tangent`."""
        rows = [list(self.poses).index(index) for index in (earlier, later)]
        by = relative_jacobians(self.poses[earlier], self.poses[later])
        free = np.hstack([each[np.ix_(tangent, tangent)] for each in by])
        both = self.poses_covariance[rows][:, :, rows].reshape(len(free.T), -1)
        return self.poses[earlier].inverse() @ self.poses[later], free @ both @ free.T

    def is_below(self, chi2: float) -> bool:
        """Return whether the camera lies below the floor by more than this χ² of its height."""
        height = self.map_from_camera.translation[2]
        return bool(height < 0 and height**2 > chi2 * np.linalg.inv(self.information)[2, 2])

    @property
    def wrong(self) -> int:
        """How many sightings the mode takes as wrong."""
        return sum(reading is None for row in self.readings.values() for reading in row)

    @property
    def right_pictures(self) -> int:
        """How many pictures have a sighting that is right by the mode."""
        return sum(any(reading is not None for reading in row) for row in self.readings.values())


class VisitModes(Struct, frozen=True):
    """A visit with its modes, best first. `nothing`: the score if all of its sightings are wrong,
    each by itself or, in a single picture, together;
    `right`: (stamp_ns, index) of the chosen pictures in which every mode has a right sighting."""

    visit: Visit
    modes: tuple[Mode, ...]
    nothing: float
    right: tuple[tuple[int, int], ...]

    @property
    def is_one_picture(self) -> bool:
        """Whether every mode rests on a single picture, all others being wrong."""
        return all(mode.right_pictures == 1 for mode in self.modes)
