"""Estimates a robot's pose before a located camera, and the reading of what the camera saw."""

from copy import copy

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.gates import WILD_SHARE
from trigpoint.fusion.model.observations import Observation, Reading, corners_in_base
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Target

from .best_readings import best_readings
from .faces import candidates, is_same_pose, pixels_of

# With a prior tighter than this, poses that a look-alike face or a turned board would need are
# many sigmas away, so that only readings near the prior need to be looked at.
_TIGHT_M = 0.15
_TIGHT_RAD = 0.15
# A reading is excluded where its χ² is worse by this much to first order; e^(-100/2) is negligible.
_HOPELESS = 100.0
# A corner with a larger residual at its view's best pose near the prior is an outlier; a view that
# moves the robot by so many of the prior's sigmas is wrong.
_FITS_SIGMAS = 6.0
# A pose with an RMS residual this large is impossible: the ambiguity of one flat face is less.
_FAR_RMS_SIGMAS = 100.0
_REAL = np.float64
_EQUATIONS = (
    *(In(_REAL, ("p",)), In(_REAL, (1, 12)), In(_REAL, ("n", 2)), In(_REAL, ("n",))),
    *(In(_REAL, ("q", 12)), In(_REAL, ("r", "d")), In(np.int64, ("d",))),
)
_ALIGNED = Kernel(
    *("tp_aligned", *_EQUATIONS, In(_REAL, ("b", "n", 3)), In(_REAL, ("b", 12))),
    *(Out(_REAL, ("b", 12)), Out(_REAL, ("b",))),
)
_NEARLY = Kernel(
    *("tp_aligned_nearly", *_EQUATIONS, In(_REAL, ("b", "n", 3)), In(_REAL, (1, 12))),
    Out(_REAL, ("b",)),
)
_ROBUSTLY = Kernel(
    *("tp_aligned_robustly", *_EQUATIONS, In(_REAL, ("n", 3)), In(_REAL, (1, 12))),
    *(Out(_REAL, ("n",)), Out(_REAL, (1,))),
)


class Alignment(Struct, frozen=True):
    """A robot's pose before a located camera; `cost`: χ², the prior's included; `margin`: by how
    much the next best reading is worse; `wild`: (n,) bool over all corners, the outliers left
    out."""

    map_from_base: Pose
    readings: tuple[Reading, ...]
    cost: float
    margin: float
    wild: np.ndarray

    def read(self, observation: Observation) -> Observation:
        """The observation with these readings and outlier corners."""
        return observation.read_as(self.readings).marked(self.wild)


class PosePrior(Struct, frozen=True):
    """What is known of map_from_base before a sighting: covariance (6, 6) of its disturbance."""

    map_from_base: Pose
    covariance: Array

    def is_tight(self, tangent: list[int]) -> bool:
        """Whether it is tight enough to tell faces apart that look alike."""
        sigma = np.sqrt(np.diagonal(self.covariance)[tangent])
        return bool(sigma[:2].max() < _TIGHT_M and sigma[-1] < _TIGHT_RAD)


def align(
    observation: Observation,
    target: Target,
    lens: CameraModel,
    map_from_camera: Pose,
    *,
    tangent: list[int],
    prior: PosePrior | None,
    extra_sigma_px: float,
) -> Alignment | None:
    """The reading and robot pose that fit a located camera's observation and the prior best.

    `extra_sigma_px`: what the camera's own uncertainty adds to the corners'.
    """
    search = _Search(observation, target, lens, map_from_camera, tangent, prior, extra_sigma_px)
    if prior is None or not prior.is_tight(tangent):
        return search.everywhere()
    near = search.near(prior)
    if near is not None:
        return near
    # At a prior that is off by the distance of two faces, one is read as its neighbour.
    best = search.everywhere()
    if best is not None and search.fits(best.cost):
        return best
    wild = search.wild_near(prior)
    if np.all(wild):
        return None
    sound = search.without(wild)
    return sound.near(prior) or sound.everywhere()


def placements(
    observation: Observation,
    target: Target,
    lens: CameraModel,
    map_from_camera: Pose,
    *,
    tangent: list[int],
) -> list[Pose]:
    """Every pose of a robot before a located camera that one observation allows, best first."""
    search = _Search(observation, target, lens, map_from_camera, tangent, None, 0.0)
    starts, readings = search._starts()
    if not starts:
        return []
    poses, costs = search._solved(Pose.stack(starts), np.stack(readings))
    found: list[Pose] = []
    for index in np.argsort(costs, kind="stable"):
        is_near = bool(costs[index] < _FAR_RMS_SIGMAS**2 * 2 * len(search.pixels))
        if is_near and not any(is_same_pose(poses[index], other) for other in found):
            found.append(poses[index])
    return found


class _Search:
    """The search behind `align`, for one observation."""

    def __init__(
        self,
        observation: Observation,
        target: Target,
        lens: CameraModel,
        map_from_camera: Pose,
        tangent: list[int],
        prior: PosePrior | None,
        extra_sigma_px: float,
    ) -> None:
        self.observation, self.target, self.lens = observation, target, lens
        self.map_from_camera, self.tangent, self.prior = map_from_camera, tangent, prior
        self.pixels, sigma = pixels_of(observation)
        # By view, its corners (r, n, 3) in the robot's frame for each of its readings.
        self.corners = [
            np.stack([corners_in_base(view, reading, target) for reading in view.readings])
            for view in observation.views
        ]
        self.extra_variance = extra_sigma_px**2
        self.weights = 1 / np.sqrt(sigma**2 + self.extra_variance)
        self.wild = np.zeros(len(self.pixels), dtype=bool)
        self.root = np.zeros((0, len(tangent)))  # of the prior's information
        if prior is not None:
            covariance = prior.covariance[np.ix_(tangent, tangent)]
            self.root = np.linalg.inv(np.linalg.cholesky(covariance))

    def without(self, wild: np.ndarray) -> "_Search":
        """The same search without some corners (n,)."""
        other = copy(self)
        other.wild = wild
        other.weights = np.where(wild, 0.0, self.weights)
        return other

    def wild_near(self, prior: PosePrior) -> np.ndarray:
        """Which corners (n,) fit nowhere near the prior, each view judged by itself: single ones
        that lie elsewhere, or all of a view that shows something else than it claims."""
        parts = []
        for view, corners in zip(self.observation.views, self.corners, strict=True):
            alone = copy(self)
            alone.observation = replace(self.observation, views=(view,))
            alone.corners = [corners]
            alone.pixels, sigma = pixels_of(alone.observation)
            alone.weights = 1 / np.sqrt(sigma**2 + self.extra_variance)
            parts.append(alone._wild_in_view(prior))
        return np.concatenate(parts)

    def _wild_in_view(self, prior: PosePrior) -> np.ndarray:
        nothing = np.ones(len(self.pixels), dtype=bool)
        readings = self._read_at(prior.map_from_base)
        if readings is None:
            return nothing
        length, pull = np.empty(len(self.pixels)), np.empty(1)
        points = self._points(readings[None])[0]
        if not _ROBUSTLY(*self._given, points, prior.map_from_base.rows(), length, pull):
            return nothing
        is_elsewhere = pull[0] > _FITS_SIGMAS**2
        wild = length > _FITS_SIGMAS
        return nothing if is_elsewhere or wild.mean() > WILD_SHARE else wild

    def near(self, prior: PosePrior) -> Alignment | None:
        """The reading that fits at the prior; None where it does not fit or another may too."""
        readings = self._read_at(prior.map_from_base)
        if readings is None:
            return None
        poses, costs = self._solved(Pose.stack([prior.map_from_base]), readings[None])
        if not self.fits(float(costs[0])):
            return None
        margin = self._margin_at(poses, readings, float(costs[0]))
        if margin < _HOPELESS:
            return None
        return Alignment(poses[0], self._named(readings), float(costs[0]), margin, self.wild)

    def fits(self, cost: float) -> bool:
        """Whether the corners can have this cost, by their number."""
        freedom = 2 * int(np.sum(~self.wild))
        return cost < freedom + 6 * np.sqrt(2 * freedom)

    def _margin_at(self, pose: Pose, readings: np.ndarray, cost: float) -> float:
        """How much worse the observation fits with another reading of any one view, to first order
        about a pose (1)."""
        others = []
        for order, view in enumerate(self.observation.views):
            for number in set(range(len(view.readings))) - {int(readings[order])}:
                other = readings.copy()
                other[order] = number
                others.append(other)
        if not others:
            return np.inf
        costs = np.empty(len(others))
        _NEARLY(*self._given, self._points(np.stack(others)), pose.rows(), costs)
        return float(costs.min()) - cost

    def everywhere(self) -> Alignment | None:
        """The best alignment of all candidates."""
        starts, readings = self._starts()
        if not starts:
            return None
        chosen = np.stack(readings)
        poses, costs = self._solved(Pose.stack(starts), chosen)
        if not np.any(np.isfinite(costs)):
            return None
        best = int(np.argmin(costs))
        differs = np.any(chosen != chosen[best], axis=1)
        second = float(np.min(costs[differs], initial=np.inf))
        named = self._named(chosen[best])
        margin = second - float(costs[best])
        return Alignment(poses[best], named, float(costs[best]), margin, self.wild)

    def _starts(self) -> tuple[list[Pose], list[np.ndarray]]:
        """The poses at which the robot may be, and the observation's readings at each of them."""
        starts, readings = [], []
        for candidate in candidates(self.observation, self.target, self.lens):
            starts.append(self.map_from_camera @ candidate.camera_from_base)
            views = zip(self.observation.views, candidate.readings, strict=True)
            readings.append(np.array([view.readings.index(chosen) for view, chosen in views]))
        if self.prior is not None:
            read = self._read_at(self.prior.map_from_base)
            if read is not None:
                starts.append(self.prior.map_from_base)
                readings.append(read)
        return starts, readings

    def _read_at(self, map_from_base: Pose) -> np.ndarray | None:
        """For each view the index of the reading that fits a pose best; None where none does."""
        views = self.observation.views
        there = (self.map_from_camera.inverse() @ map_from_base).repeated(len(views))
        chosen, rms = best_readings(views, self.target, self.lens, there)
        if not np.all(np.isfinite(rms)):
            return None
        found = zip(views, chosen, strict=True)
        return np.array([view.readings.index(reading) for view, reading in found])

    def _named(self, readings: np.ndarray) -> tuple[Reading, ...]:
        views = zip(self.observation.views, readings, strict=True)
        return tuple(view.readings[number] for view, number in views)

    def _solved(self, starts: Pose, readings: np.ndarray) -> tuple[Pose, Array]:
        """Gauss-Newton over the robot's pose from starts (b) with readings (b, views): the poses
        and their costs (b,), infinite where it diverges."""
        poses, costs = np.empty((len(readings), 12)), np.empty(len(readings))
        begin = _flattened(starts, self.tangent).rows()
        _ALIGNED(*self._given, self._points(readings), begin, poses, costs)
        return Pose.from_rows(poses), costs

    def _points(self, readings: np.ndarray) -> Array:
        """The corners in the robot's frame by readings (b, views), (b, n, 3)."""
        chosen = zip(self.corners, readings.T, strict=True)
        return np.concatenate([corners[numbers] for corners, numbers in chosen], axis=1)

    @property
    def _given(self) -> tuple[np.ndarray, ...]:
        """The equations as the core takes them: `Equations` of `alignment.cpp`."""
        prior = np.empty((0, 12)) if self.prior is None else self.prior.map_from_base.rows()
        return (
            *(self.lens.parameters, self.map_from_camera.rows()),
            *map(np.ascontiguousarray, (self.pixels, self.weights)),
            *(prior, self.root, np.array(self.tangent, dtype=np.int64)),
        )


def _flattened(poses: Pose, tangent: list[int]) -> Pose:
    """Poses (b), projected into the plane for a robot that moves in it."""
    if len(tangent) == 6:
        return poses
    return Pose.planar(poses.translation[:, 0], poses.translation[:, 1], poses.heading)
