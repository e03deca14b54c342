"""Where a fit of a lens begins: poses of views through a supposed lens, and lenses to suppose.

A lens is first supposed equidistant, as any lens nearly is that far as one coefficient tells. The
one thing to guess is then its focal length, and a dozen guesses from tele to fisheye are tried. The
polynomials begin at the radial profile of the equidistant lens that was fitted.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array, hat

from .bundle_adjustment import Scene, Solution, adjusted, are_before
from .calibration_views import FEWEST_CORNERS, View

# Half the field of view along the picture's diagonal, degrees: from tele to fisheye.
_HALF_DIAGONALS_DEG = (8, 12, 18, 25, 32, 40, 48, 56, 64, 72, 80, 88, 98, 110)
# How many of them are followed to the end, and how many steps each may take to show what it is.
_FOLLOWED = 3
_POSE_STEPS, _LENS_STEPS = 6, 25
# Of the views, how many a guess must have a place for, and how many at least.
_LEAST_PLACED, _FEWEST = 0.6, 4
# The profile is compared up to this angle from the axis, beyond which x/z says little.
_WIDEST_RAD = np.radians(80.0)
_PROFILE_POINTS = 60


class _Guess(Struct, frozen=True, eq=False):
    """A lens that is supposed, the poses of those views that it has a place for, and how far the
    median corner is off."""

    camera: CameraModel
    views: list[View]
    poses: tuple[Pose, ...]
    off_px: float


def equidistant_start(views: Sequence[View], size: tuple[int, int]) -> Solution | None:
    """The equidistant lens that explains views best, from nothing, with the poses of those views
    that it has a place for; `size`: width, height."""
    guesses = [guess for angle in _HALF_DIAGONALS_DEG if (guess := _guessed(angle, views, size))]
    guesses.sort(key=lambda guess: guess.off_px)
    found = [lens for guess in guesses[:_FOLLOWED] if (lens := _refined(guess)) is not None]
    return min(found, key=lambda lens: float(np.median(np.abs(lens.errors))), default=None)


def _guessed(
    half_diagonal_deg: float, views: Sequence[View], size: tuple[int, int]
) -> _Guess | None:
    """A guess with what it makes of the views; None where it has no place for most of them."""
    width, height = size
    focal = np.hypot(width, height) / 2 / np.radians(half_diagonal_deg)
    centre = (width - 1) / 2, (height - 1) / 2
    camera = CameraModel(width, height, focal, focal, *centre, model=LensModel.EQUIDISTANT)
    places = [
        (view, pose)
        for view in views
        if (pose := pose_through(camera, view)) is not None and are_before(pose @ view.points)
    ]
    if len(places) < max(_FEWEST, _LEAST_PLACED * len(views)):
        return None
    kept = [view for view, _ in places]
    scene = Scene.of(kept)
    placed = adjusted(scene, camera, [pose for _, pose in places], free=(), steps=_POSE_STEPS)
    if placed is None:
        return None
    return _Guess(camera, kept, placed.poses, float(np.median(np.abs(placed.errors))))


def _refined(guess: _Guess) -> Solution | None:
    """What the views make of a guess: first its focal length, then all of it."""
    scene, camera, poses = Scene.of(guess.views), guess.camera, guess.poses
    found: Solution | None = None
    for free in ((0, 1), (0, 1, 2, 3, 4), (0, 1, 2, 3, 4, 5), None):
        found = adjusted(scene, camera, poses, free=free, steps=_LENS_STEPS)
        if found is None:
            return None
        camera, poses = found.camera, found.poses
    return found


def pose_through(camera: CameraModel, view: View) -> Pose | None:
    """About where a view's face was, through a lens that is supposed; None where the lens has no
    directions for its pixels, or the corners lie on no plane before it.

    Its homography to directions on the unit sphere, which has no horizon that a wide lens could
    meet (Kannala and Brandt, «A generic camera model», 2006, VI.B).
    """
    flat = camera.directions(view.pixels)
    known = np.isfinite(flat).all(axis=1)
    if known.sum() < FEWEST_CORNERS:
        return None
    rays, places = np.ones((2, known.sum(), 3))
    rays[:, :2] = flat[known]
    rays /= np.sqrt(np.einsum("ni,ni->n", rays, rays))[:, None]
    plane = view.points[known, :2]
    middle = plane.mean(axis=0)
    size = float(np.abs(plane - middle).max())
    places[:, :2] = (plane - middle) / size
    # Equations ray × homography place = 0: hat(ray)ᵀ hat(ray) is 1 - ray rayᵀ.
    along = (rays[:, :, None] * places[:, None]).reshape(-1, 9)
    normal = (-along.T @ along).reshape(3, 3, 3, 3)
    normal[(0, 1, 2), :, (0, 1, 2)] += places.T @ places
    homography = np.linalg.eigh(normal.reshape(9, 9))[1][:, 0].reshape(3, 3)
    if np.sum((places @ homography.T) * rays) < 0:
        homography = -homography
    return _pose_of(homography, middle, size)


def _pose_of(homography: Array, middle: Array, size: float) -> Pose | None:
    """The pose whose plane a homography maps, from the plane's own coordinates about `middle`."""
    axes = homography[:, :2] / size
    length = float(np.sqrt(np.prod(np.linalg.norm(axes, axis=0))))
    if not length > 0:
        return None
    first, second = (axes / length).T
    left, _, right = np.linalg.svd(np.column_stack([first, second, hat(first) @ second]))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    translation = homography[:, 2] / length - rotation[:, :2] @ middle
    return Pose(rotation, translation)


def polynomial_from(camera: CameraModel, model: LensModel, pixels: Array) -> CameraModel:
    """The polynomial lens with the radial profile of an equidistant one, as far as corners lie;
    `pixels`: (n, 2) where they do."""
    away = np.linalg.norm(camera.directions(pixels), axis=-1)
    farthest = min(float(np.nanmax(np.arctan(away), initial=0.1)), _WIDEST_RAD)
    angle = np.linspace(0.0, farthest, _PROFILE_POINTS + 1)[1:]
    k1, k2, k3, k4 = camera.distortion
    square = angle * angle
    bent = angle * (1 + square * (k1 + square * (k2 + square * (k3 + square * k4))))
    coefficients = _radial(np.tan(angle), bent, is_rational=model is not LensModel.PLUMB_BOB)
    size, focal, centre = (
        (camera.width, camera.height),
        (camera.fx, camera.fy),
        (camera.cx, camera.cy),
    )
    return CameraModel(*size, *focal, *centre, coefficients, model)


def _radial(radius: Array, bent: Array, *, is_rational: bool) -> tuple[float, ...]:
    """k1 k2 p1 p2 k3, and k4 k5 k6 where rational, by linear least squares: of
    radius · (1 + k1 r² + …) = bent · (1 + k4 r² + …), every equation of its own radius's scale."""
    even = radius[:, None] ** np.array([2, 4, 6])
    columns = radius[:, None] * even
    if is_rational:
        columns = np.hstack([columns, -bent[:, None] * even])
    scale = 1 / (radius * (1 + even[:, -1])) if is_rational else 1 / radius
    solution, *_ = np.linalg.lstsq(columns * scale[:, None], (bent - radius) * scale, rcond=1e-12)
    k1, k2, k3, *below = solution.tolist()
    return (k1, k2, 0.0, 0.0, k3, *below)
