"""Reads the other pictures of a visit once its camera is known, and finds what of each is wrong.

Odometry from the nearest known picture tells roughly where the robot stood; the views of one
picture constrain it further for each other, since they share one pose of the robot.
"""

from collections.abc import Sequence

import numpy as np

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Reading, View, corners_in_base
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.best_readings import best_readings, groups_of
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .events import Events
from .sightings import all_without_wild

# How many pictures are read at once: some megabytes of derivatives.
_MOST_AT_ONCE = 512
# The least variance with which a picture tells the robot's pose, m² and rad².
_EXACT = 1e-12

# A reading for each view, None where it is wrong, and its wild corners.
ReadPicture = tuple[tuple[Reading | None, ...], tuple[np.ndarray, ...]]


class PictureReader:
    """Reads pictures of one robot by a camera whose pose is known, each by itself.

    `places`: base_from_face of all faces where they are estimated; `is_strict`: a sighting is wrong
    if it is off by more than chance, however little that is; otherwise only if a board anywhere in
    the room is likelier.
    """

    def __init__(
        self,
        data: DataSet,
        robot: str,
        camera: CameraState,
        events: Events,
        places: Pose | None = None,
        *,
        is_strict: bool = False,
    ) -> None:
        self.camera, self.events, self.places = camera, events, places
        self._excess = events.excess if is_strict else events.over_anywhere
        self.target, self.jitter = data.targets[robot], data.jitter.get(robot)

    def read(
        self, observations: Sequence[Observation], map_from_base: Pose, drift: Array
    ) -> list[ReadPicture]:
        """Read observations (n), each with the robot at the given pose (n).

        `drift` (n, 6, 6): the covariance of these poses, without what each picture itself tells.
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
        poses, camera = map_from_base[owner], self.camera
        from_map = camera.map_from_camera.inverse()
        readings, rms = best_readings(views, self.target, camera.lens, from_map @ poses)
        step, own = np.zeros((len(views), 6)), np.zeros((len(views), 6, 6))
        wild = [np.zeros(len(view.corners), dtype=bool) for view in views]
        in_sight = np.flatnonzero(np.isfinite(rms))
        if len(in_sight):
            seen, chosen = [views[row] for row in in_sight], [readings[row] for row in in_sight]
            step[in_sight], own[in_sight], flags = self._shown(seen, chosen, poses[in_sight])
            for row, each in zip(in_sight.tolist(), flags, strict=True):
                wild[row] = each[: len(wild[row])]
        is_right = np.zeros(len(views), dtype=bool)
        is_right[in_sight] = self._are_right(owner[in_sight], step[in_sight], own[in_sight], drift)
        right = [r if is_used else None for r, is_used in zip(readings, is_right, strict=True)]
        ends = np.cumsum([len(observation.views) for observation in observations]).tolist()
        return [
            (tuple(right[start:end]), tuple(wild[start:end]))
            for start, end in zip([0, *ends[:-1]], ends, strict=True)
        ]

    def _shown(
        self, views: Sequence[View], readings: Sequence[Reading], map_from_base: Pose
    ) -> tuple[Array, Array, np.ndarray]:
        """The corrections (v, 6) of the robot's pose by views (v) of at most n corners, read so,
        their covariances (v, 6, 6) by the corners, and the wild corners (v, n)."""
        by_base, residual = self._linearised(views, readings, map_from_base)
        step, wild = np.empty((len(views), 6)), np.zeros(by_base.shape[:2], dtype=bool)
        widths = [len(view.corners) for view in views]
        for rows in groups_of(widths):
            part = rows, slice(widths[rows[0]])
            step[rows], wild[part] = all_without_wild(
                by_base[part], residual[part], self.events.wild_score
            )
        flat = (by_base * ~wild[..., None, None]).reshape(len(views), -1, 6)
        information = np.swapaxes(flat, 1, 2) @ flat + np.diag(1 / self.events.room_variances)
        return step, np.linalg.pinv(information, hermitian=True) + _EXACT * np.eye(6), wild

    def _are_right(self, owner: np.ndarray, step: Array, own: Array, drift: Array) -> np.ndarray:
        """Which views (v,) are right. Those of one picture (`owner`) are judged likeliest first,
        each against the robot's pose by odometry and the views before it (a Kalman filter). If the
        first does not fit, none is right, unless others agree with it so well that an error of
        odometry is likelier."""
        # The pose by the nearest picture is as uncertain as that by this one.
        before = own + drift[owner]
        if self.jitter is not None:
            before = before + 2 * np.diag(self.jitter.variances)
        chi2, room = _surprise(step, before + own)
        order = np.lexsort((self._excess(chi2, room), owner))
        rank = np.zeros(len(owner), dtype=int)
        rank[order] = np.arange(len(owner)) - np.searchsorted(owner[order], owner[order])
        mean, known = np.zeros((len(drift), 6)), np.zeros(drift.shape)
        is_right, is_fit = np.ones(len(owner), dtype=bool), np.zeros(len(drift), dtype=bool)
        score, count = np.zeros(len(drift)), np.zeros(len(drift), dtype=int)
        for turn in range(rank.max(initial=-1) + 1):
            rows = np.flatnonzero(rank == turn)
            place = owner[rows]
            prior = known[place] if turn else before[rows]
            error, spread = step[rows] - mean[place], prior + own[rows]
            chi2, room = _surprise(error, spread)
            fits = self._excess(chi2, room) < 0
            if turn:
                is_right[rows] = fits
            else:
                is_fit[place] = fits
            score[place] += is_right[rows] * self.events.over_anywhere(chi2, room)
            count[place] += is_right[rows]
            gain = np.swapaxes(np.linalg.solve(spread, prior), 1, 2) * is_right[rows, None, None]
            mean[place] += (gain @ error[..., None])[..., 0]
            known[place] = prior - gain @ prior
        is_fit |= (count > 1) & (score < 0)
        return is_right & is_fit[owner]

    def _linearised(
        self, views: Sequence[View], readings: Sequence[Reading], map_from_base: Pose
    ) -> tuple[Array, Array]:
        """Derivatives (v, n, 2, 6) of the views' residuals by the robot's pose in the map, and the
        residuals (v, n, 2), in sigmas; both are 0 where a view has fewer corners."""
        camera, widths = self.camera, np.array([len(view.corners) for view in views])
        is_there = np.arange(widths.max()) < widths[:, None]
        points, pixels = np.zeros((*is_there.shape, 3)), np.zeros((*is_there.shape, 2))
        chosen = zip(views, readings, strict=True)
        points[is_there] = np.concatenate(
            [corners_in_base(*each, self.target, self.places) for each in chosen]
        )
        pixels[is_there] = np.concatenate([view.pixels for view in views])
        found = projected(camera.lens, map_from_base, points, camera.map_from_camera)
        weight = is_there[..., None] / np.array([view.sigma for view in views])[:, None, None]
        return found.by_body * weight[..., None], (found.pixels - pixels) * weight


def _surprise(error: Array, spread: Array) -> tuple[Array, Array]:
    """νᵀS⁻¹ν and ln|S| of errors ν (v, 6) with covariances S (v, 6, 6)."""
    spread = symmetric(spread)
    pulled = np.linalg.solve(spread, error[..., None])[..., 0]
    return np.sum(error * pulled, axis=1), np.linalg.slogdet(spread)[1]
