"""One more picture of a visit whose camera is known: how it is read, and what of it is wrong."""

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Reading, View
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.faces import best_reading
from trigpoint.fusion.reading.visibility import body_of, by_reading
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .events import Events
from .local import Mode
from .sightings import without_wild


class PictureReader:
    """Reads pictures by a visit's mode, each by itself."""

    def __init__(self, data: DataSet, mode: Mode, events: Events) -> None:
        self.data, self.mode, self.events = data, mode, events

    def read(
        self, observation: Observation, map_from_base: Pose, drift: Array
    ) -> tuple[tuple[Reading | None, ...], tuple[np.ndarray, ...]]:
        """A reading for each view, None where it is wrong, and its wild corners.

        `drift` (6, 6): the covariance of where the robot stood beside what one picture tells.
        """
        target = self.data.targets[observation.robot]
        camera = self.mode.camera
        camera_from_base = camera.map_from_camera.inverse() @ map_from_base
        jitter = self.data.jitter.get(observation.robot)
        readings: list[Reading | None] = []
        wilds: list[np.ndarray] = []
        for view in observation.views:
            reading, rms, _ = best_reading(view, target, camera.lens, camera_from_base)
            by_base, residual = self._linearised(observation, view, reading, map_from_base)
            step, wild = without_wild(by_base, residual, self.events.wild_score)
            flat = by_base[~wild].reshape(-1, 6)
            own = np.linalg.pinv(flat.T @ flat, hermitian=True)
            # What the nearest picture says of the robot is as uncertain as this one.
            spread = 2 * own + drift + (0.0 if jitter is None else 2 * np.diag(jitter.variances))
            spread = 0.5 * (spread + spread.T) + 1e-12 * np.eye(6)
            score = float(step @ np.linalg.solve(spread, step))
            room = min(float(np.linalg.slogdet(spread)[1]), self.events.pose_score)
            is_right = np.isfinite(rms) and score + room < self.events.wrong_limit
            readings.append(reading if is_right else None)
            wilds.append(wild)
        return tuple(readings), tuple(wilds)

    def _linearised(
        self, observation: Observation, view: View, reading: Reading, map_from_base: Pose
    ) -> tuple[Array, Array]:
        """Derivative (n, 2, 6) of a view's residual by the robot's pose in the map, and the
        residual (n, 2), in sigmas."""
        camera = self.mode.camera
        body = body_of(self.data.targets[observation.robot])
        points = by_reading(view, body)[view.readings.index(reading)]
        found = projected(camera.lens, map_from_base, points, camera.map_from_camera)
        return found.by_body / view.sigma, (found.pixels - view.pixels) / view.sigma
