"""What one sighting says by itself: how well a board fits it, its wild (outlier) corners, and its
score if it is wrong."""

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.observations import Observation, View, face_points, swept
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import median
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Target

from .events import Events

_LEAST_GOOD = 4
_LEAST_CORNERS = 12
_REAL = np.float64
_BOARD_FITS = Kernel(
    "tp_board_fits",
    In(_REAL, ("p",)),
    In(_REAL, ("n", 3)),
    In(_REAL, ("n", 2)),
    *(float, float),
    In(_REAL, ("b", 3, 3)),
    In(_REAL, ("b", 3)),
    Out(_REAL, ("b",)),
    Out(_REAL, ("b", "n")),
    Out(np.bool_, ("b", "n")),
)
_ON_ONE_PLANE = Kernel(
    "tp_on_one_plane", In(_REAL, ("n", 2)), In(_REAL, ("n", 2)), float, Out(np.bool_, ("n",))
)
_WITHOUT_WILD = Kernel(
    "tp_without_wild",
    In(_REAL, ("v", "n", 12)),
    In(_REAL, ("v", "n", 2)),
    float,
    Out(_REAL, ("v", 6)),
    Out(np.bool_, ("v", "n")),
)
_PLANE = Kernel(
    "tp_plane_poses",
    In(_REAL, ("p",)),
    In(_REAL, ("n", 3)),
    In(_REAL, ("n", 2)),
    float,
    Out(_REAL, (2, 3, 3)),
    Out(_REAL, (2, 3)),
    Out(_REAL, (2,)),
)


class Alone(Struct, frozen=True):
    """What one view says by itself.

    `wrong_score`: the score if the view is wrong, of a board that is somewhere else; `scatter`: the
    corners' variance about the best fit over the stated one, without corners that are wild by the
    median distance; NaN where there are too few corners; `wild`: flags of the wild corners, (n,).
    """

    wrong_score: float
    scatter: float
    wild: np.ndarray


def tamed(observation: Observation, views: tuple[Alone, ...]) -> Observation:
    """An observation without the corners that each of its views by itself shows to be wild."""
    if not any(np.any(view.wild) for view in views):
        return observation
    kept = []
    for view, by_itself in zip(observation.views, views, strict=True):
        good = ~by_itself.wild
        sweep = None if view.sweep is None else view.sweep.where(good)
        kept.append(
            replace(view, corners=view.corners[good], pixels=view.pixels[good], sweep=sweep)
        )
    return replace(observation, views=tuple(kept), outliers=())


def by_itself(view: View, lens: CameraModel, target: Target, events: Events) -> Alone:
    """Fit one view by itself; where no board fits at all, the view is wrong and tells nothing.

    A flat board has two poses that look much alike, and wild corners may make the wrong one of them
    the better start, or spoil both. So where any corner is wild, every start is fitted, those from
    the corners that one homography maps too, and the best fit counts.
    """
    fit = _best_fit(view, lens, target, events)
    if fit is None:
        return Alone(events.wrong_limit, np.nan, np.zeros(len(view.corners), dtype=bool))
    score, left, wild = fit
    scatter = np.nan
    if len(left) >= _LEAST_CORNERS:
        # Half of all distances from the mean are beyond √(2 ln 2) σ; the fit takes three corners.
        share = 1 - 3 / len(left)
        middle = median(left) / (2 * math.log(2) * share)
        kept = left[left < events.wild_score * middle]
        scatter = float(np.mean(kept)) / (2 * share)
    return Alone(score + events.wrong_limit, scatter, wild)


class PoseFit(Struct, frozen=True):
    """camera_from_object, and the reprojection's RMS of a coordinate in sigmas."""

    pose: Pose
    rms: float


def planar_poses(lens: CameraModel, points: Array, pixels: Array, sigma: float) -> list[PoseFit]:
    """Both poses of one plane, best first, which often fit equally well (Collins and Bartoli,
    «Infinitesimal plane-based pose estimation», 2014); points (n, 3) with z = 0, pixels (n, 2) raw.

    z points away from whoever sees the plane's front: what fits from behind alone, as a mirrored
    order of the corners does, is left out. An empty list where fewer than four corners are seen or
    they lie on a line.
    """
    rotation, translation, rms = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(2)
    count = _PLANE(
        lens.parameters,
        np.ascontiguousarray(points),
        np.ascontiguousarray(pixels),
        sigma,
        *(rotation, translation, rms),
    )
    return [PoseFit(Pose(rotation[i], translation[i]), float(rms[i])) for i in range(count)]


def _best_fit(
    view: View, lens: CameraModel, target: Target, events: Events
) -> tuple[float, Array, np.ndarray] | None:
    """Return the best of `_fit` from every start; None where there is none."""
    reading = view.readings[0]  # every other reading is of the same board
    face = target.faces[reading.face]
    flat = face_points(face, view.corners, is_turned=reading.is_turned)
    points = swept(flat, view, face)
    starts = planar_poses(lens, flat, view.pixels, view.sigma)
    tried = _fits(starts[:1], points, view, lens, events)
    if tried and np.all(tried[0][1] < events.wild_score):
        return tried[0]
    in_plane = _on_one_plane(flat, view.pixels, lens, math.sqrt(events.wild_score) * view.sigma)
    if not np.all(in_plane):
        starts += planar_poses(lens, flat[in_plane], view.pixels[in_plane], view.sigma)
    tried += _fits(starts[len(tried) :], points, view, lens, events)
    return min(tried, key=_score, default=None)


def _score(fit: tuple[float, Array, np.ndarray]) -> float:
    """The score of a fit; infinite where it diverged."""
    return fit[0] if np.isfinite(fit[0]) else np.inf


def _on_one_plane(flat: Array, pixels: Array, lens: CameraModel, limit: float) -> np.ndarray:
    """Which corners (n,) the homography that fits most of them maps to within `limit` (pixels)
    of where they are; all where there is none."""
    directions, kept = lens.directions(pixels), np.ones(len(flat), dtype=bool)
    if len(flat) > _LEAST_GOOD and np.all(np.isfinite(directions)):
        points = np.ascontiguousarray(flat[:, :2]), np.ascontiguousarray(directions)
        _ON_ONE_PLANE(*points, float(limit / lens.fx), kept)
    return kept


def _fits(
    starts: list[PoseFit], points: Array, view: View, lens: CameraModel, events: Events
) -> list[tuple[float, Array, np.ndarray]]:
    """Fit the pose from each start; for each the score of the fit with the pose integrated out,
    every corner's χ² about it (n,), and which corners are wild (n,)."""
    shape = len(starts), len(points)
    scores, chi2, wild = np.empty(len(starts)), np.empty(shape), np.empty(shape, dtype=bool)
    poses = Pose.stack([start.pose for start in starts])
    _BOARD_FITS(
        lens.parameters,
        np.ascontiguousarray(points),
        np.ascontiguousarray(view.pixels),
        *(view.sigma, events.wild_score),
        *(poses.rotation, poses.translation),
        *(scores, chi2, wild),
    )
    return list(zip(scores.tolist(), chi2, wild, strict=True))


def all_without_wild(by_pose: Array, residual: Array, limit: float) -> tuple[Array, np.ndarray]:
    """For sightings (v) with equally many corners (n), each by itself: the least-squares steps
    (v, 6) of the pose without the wild corners, and which corners are wild (v, n): those whose χ²
    exceeds `limit` about a fit that starts from Cauchy weights.

    `by_pose`: (v, n, 2, 6); `residual`: (v, n, 2), in sigmas.
    """
    count, corners = residual.shape[:2]
    step, wild = np.empty((count, 6)), np.empty((count, corners), dtype=bool)
    by_pose = np.ascontiguousarray(by_pose).reshape(count, corners, 12)
    _WITHOUT_WILD(by_pose, np.ascontiguousarray(residual), limit, step, wild)
    return step, wild
