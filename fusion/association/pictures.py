"""How the other pictures of a visit whose camera is known are read, and what of each is wrong."""

from collections.abc import Sequence

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Reading, View
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.best_readings import best_readings, groups_of, points_of_views
from trigpoint.fusion.reading.visibility import body_of
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .events import Events
from .local import Mode
from .sightings import all_without_wild

# How many pictures are read at once: some megabytes of derivatives.
_MOST_AT_ONCE = 512

# A reading for each view, None where it is wrong, and its wild corners.
ReadPicture = tuple[tuple[Reading | None, ...], tuple[np.ndarray, ...]]


class PictureReader:
    """Reads pictures of one robot by a visit's mode, each by itself."""

    def __init__(self, data: DataSet, robot: str, mode: Mode, events: Events) -> None:
        self.data, self.mode, self.events = data, mode, events
        self.target, self.jitter = data.targets[robot], data.jitter.get(robot)

    def read(
        self, observations: Sequence[Observation], map_from_base: Pose, drift: Array
    ) -> list[ReadPicture]:
        """How observations (n) are read, the robot standing at (n).

        `drift` (n, 6, 6): the covariance of where it stood beside what each picture tells.
        """
        found: list[ReadPicture] = []
        for start in range(0, len(observations), _MOST_AT_ONCE):
            part = slice(start, start + _MOST_AT_ONCE)
            found += self._read(observations[part], map_from_base[part], drift[part])
        return found

    def _read(
        self, observations: Sequence[Observation], map_from_base: Pose, drift: Array
    ) -> list[ReadPicture]:
        views = [view for observation in observations for view in observation.views]
        owner = np.repeat(np.arange(len(observations)), [len(o.views) for o in observations])
        poses, camera = map_from_base[owner], self.mode.camera
        from_map = camera.map_from_camera.inverse()
        readings, rms = best_readings(views, self.target, camera.lens, from_map @ poses)
        is_right = np.isfinite(rms)
        wild: list[np.ndarray] = [np.zeros(0, dtype=bool)] * len(views)
        for rows in groups_of([len(view.corners) for view in views]):
            seen, chosen = [views[row] for row in rows], [readings[row] for row in rows]
            score, flags = self._judged(seen, chosen, poses[rows], drift[owner[rows]])
            is_right[rows] &= score < self.events.wrong_limit
            for row, each in zip(rows, flags, strict=True):
                wild[row] = each
        right = [r if is_used else None for r, is_used in zip(readings, is_right, strict=True)]
        ends = np.cumsum([len(observation.views) for observation in observations]).tolist()
        return [
            (tuple(right[start:end]), tuple(wild[start:end]))
            for start, end in zip([0, *ends[:-1]], ends, strict=True)
        ]

    def _judged(
        self, views: Sequence[View], readings: Sequence[Reading], map_from_base: Pose, drift: Array
    ) -> tuple[Array, np.ndarray]:
        """The scores (v,) of views with equally many corners (n), read so, and their wild corners
        (v, n)."""
        by_base, residual = self._linearised(views, readings, map_from_base)
        step, wild = all_without_wild(by_base, residual, self.events.wild_score)
        flat = (by_base * ~wild[..., None, None]).reshape(len(views), -1, 6)
        own = np.linalg.pinv(np.swapaxes(flat, 1, 2) @ flat, hermitian=True)
        # What the nearest picture says of the robot is as uncertain as this one.
        spread = 2 * own + drift + 1e-12 * np.eye(6)
        if self.jitter is not None:
            spread += 2 * np.diag(self.jitter.variances)
        spread = 0.5 * (spread + np.swapaxes(spread, 1, 2))
        pulled = np.linalg.solve(spread, step[..., None])[..., 0]
        room = np.minimum(np.linalg.slogdet(spread)[1], self.events.pose_score)
        return np.sum(step * pulled, axis=1) + room, wild

    def _linearised(
        self, views: Sequence[View], readings: Sequence[Reading], map_from_base: Pose
    ) -> tuple[Array, Array]:
        """Derivatives (v, n, 2, 6) of the views' residuals by the robot's pose in the map, and the
        residuals (v, n, 2), in sigmas."""
        camera = self.mode.camera
        faces = np.array([[reading.face] for reading in readings])
        is_turned = np.array([[reading.is_turned] for reading in readings])
        points = points_of_views(views, body_of(self.target), faces, is_turned)[:, 0]
        found = projected(camera.lens, map_from_base, points, camera.map_from_camera)
        pixels = np.stack([view.pixels for view in views])
        sigma = np.array([view.sigma for view in views])[:, None, None]
        return found.by_body / sigma[..., None], (found.pixels - pixels) / sigma
