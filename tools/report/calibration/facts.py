"""What the page of a calibration shows, and the figures that it is summed up in."""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.coverage.accuracy_map import AccuracyMap
from trigpoint.fusion.estimators.residuals import CameraResiduals
from trigpoint.fusion.guidance.suggestions import Suggestion
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.building import Building
from trigpoint.map.network import Network
from trigpoint.tools.networks.distances import Distances, distances
from trigpoint.tools.networks.truth import NetworkError

_ANGLE_STEP = 1e-6


class CalibrationResults(Struct, frozen=True, eq=False):
    """A calibration: the network with its joint `covariance` (6n, 6n), `trajectories` (robot ->
    (stamps_ns, map_from_base)), each camera's residuals where the estimator gives them, what was
    `left_out` of the session by reason, `notes` on it in words, the next poses to visit, the
    `error` against the truth where that is known, and which `noise` is not as stated, in words.
    `building`: where the map lies in it, None where that is not asked for, or cannot be told for
    the `building_problem`. `corrected`: how well robots would be corrected where they drove;
    `contradicted`: why located cameras are not to be used.

    `session`, `folder`: the recording and where the results are, as the reader may type them.
    """

    network: Network
    covariance: Array
    trajectories: dict[str, tuple[np.ndarray, Pose]]
    residuals: dict[str, CameraResiduals]
    left_out: dict[str, int]
    notes: list[str]
    suggestions: tuple[Suggestion, ...]
    error: NetworkError | None
    session: str
    folder: str
    building: Building | None = None
    building_problem: str = ""
    corrected: tuple[AccuracyMap, ...] = ()
    noise: tuple[str, ...] = ()
    contradicted: str = ""

    @property
    def seconds(self) -> float:
        """How long the robots' odometry lasts."""
        stamps = [s for s, _ in self.trajectories.values() if len(s)]
        if not stamps:
            return 0.0
        return float(max(s[-1] for s in stamps) - min(s[0] for s in stamps)) * 1e-9

    @property
    def worst(self) -> str | None:
        """The camera with the largest position sigma."""
        cameras = self.network.cameras
        return max(self.network.located, key=lambda n: cameras[n].position_sigma, default=None)

    @property
    def distances(self) -> Distances:
        """Between all located cameras."""
        return distances(self.network, self.covariance)

    @property
    def sightings(self) -> int:
        return sum(camera.sightings for camera in self.network.cameras.values())

    @property
    def rejected(self) -> int:
        return sum(camera.rejected for camera in self.network.cameras.values())


def view_angles(map_from_camera: Pose) -> Array:
    """Where a camera looks, degrees: azimuth of its axis from the map's x towards y, how far below
    the horizontal it points, and how far its picture is turned clockwise about the axis."""
    ahead, right = map_from_camera.rotation[:, 2], map_from_camera.rotation[:, 0]
    level = np.array([ahead[1], -ahead[0], 0.0])
    # A camera that looks straight up or down has no azimuth of its own: its picture's top has.
    level = level / max(float(np.linalg.norm(level)), 1e-12)
    below = np.cross(ahead, level)
    azimuth = np.arctan2(ahead[1], ahead[0])
    roll = np.arctan2(right @ below, right @ level)
    return np.degrees([azimuth, np.arcsin(np.clip(-ahead[2], -1, 1)), roll])


def view_angle_sigmas(map_from_camera: Pose, covariance: Array) -> Array:
    """Their standard deviations (3,), degrees, by the pose's covariance (6, 6)."""
    gradient = np.zeros((3, 3))
    for axis in range(3):
        step = np.zeros(6)
        step[3 + axis] = _ANGLE_STEP
        ends = [view_angles(map_from_camera.disturbed(sign * step)) for sign in (1, -1)]
        change = (ends[0] - ends[1] + 180.0) % 360.0 - 180.0
        gradient[:, axis] = change / (2 * _ANGLE_STEP)
    return np.sqrt(np.diagonal(gradient @ covariance[3:, 3:] @ gradient.T))
