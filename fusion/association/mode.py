"""One place of a camera by one visit."""

from dataclasses import dataclass

import numpy as np

from trigpoint.fusion.model.observations import Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import relative_jacobians


@dataclass(frozen=True, slots=True)
class Mode:
    """One place of a camera by one visit.

    `map_from_camera`: in the frame in which odometry puts the robot (the first picture's pose is
    exactly odometry's as that is stamped); `camera`: with lens and clock; `information`: of
    `columns` unknowns, pose (6), then lens and clock where they are estimated, their priors
    included, of which `prior` is ln |information|; `score`: of what is not in them; `readings`: by
    index, None for a wrong sighting; `wild`: by index, each view's wild corners; `poses`: where the
    robot stood, and `poses_covariance` (m, d, m, d) of that at its first m pictures, each `early_s`
    before it is stamped; `scales`: (2,) and their covariance, and `faces`: base_from_face of all,
    each where they are estimated.
    """

    camera: CameraState
    information: Array
    prior: float
    score: float
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

    @property
    def evidence(self) -> float:
        """The score with the camera's own unknowns integrated out."""
        return self.score + float(np.linalg.slogdet(self.information)[1]) - self.prior

    def moved(self, earlier: int, later: int, tangent: list[int]) -> tuple[Pose, Array]:
        """How the robot moved between two pictures, and the covariance (d, d) of that in its free
        directions."""
        rows = [list(self.poses).index(index) for index in (earlier, later)]
        by = relative_jacobians(self.poses[earlier], self.poses[later])
        free = np.hstack([each[np.ix_(tangent, tangent)] for each in by])
        both = self.poses_covariance[rows][:, :, rows].reshape(len(free.T), -1)
        return self.poses[earlier].inverse() @ self.poses[later], free @ both @ free.T

    @property
    def wrong(self) -> int:
        """How many sightings are wrong by it."""
        return sum(reading is None for row in self.readings.values() for reading in row)

    @property
    def right_pictures(self) -> int:
        """How many pictures show the robot by it."""
        return sum(any(reading is not None for reading in row) for row in self.readings.values())
