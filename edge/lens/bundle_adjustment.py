"""Least squares over a lens and the poses of the views that were taken through it.

Levenberg-Marquardt steps with the poses eliminated (Triggs et al., «Bundle Adjustment: A Modern
Synthesis», 2000). Our own, since OpenCV's has one start a model: on a fisheye lens it ends at 4 px
where the pictures allow 0.2, and it takes no weights.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array, exp

from .calibration_views import View

STEPS = 60
# Corners that lie farther off than so many times the usual residual pull no harder than at that.
_HUBER = 5.0
_MEDIAN_TO_SIGMA = 1.4826
_LEAST_RESIDUAL_PX = 1e-4
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-12, 1e8
_SAME_COST = 1e-7
# A corner at more than 89.4 degrees from the axis is at no finite place of x/z.
LEAST_DEPTH = 0.01


class Scene(Struct, frozen=True, eq=False):
    """The corners of all views in one row. `points`: (n, 3) in their faces' frames; `pixels`:
    (n, 2); `view`: (n,) which view each is in, rising; `begins`: (views,); `weight`: (n,) of a
    corner's square."""

    points: Array
    pixels: Array
    view: np.ndarray
    begins: np.ndarray
    weight: Array

    @classmethod
    def of(cls, views: Sequence[View], weights: Array | None = None) -> "Scene":
        """`weights`: (views,), of each view; all 1 where they are left out."""
        lengths = np.array([len(view) for view in views])
        each = np.ones(len(views)) if weights is None else weights
        return cls(
            np.concatenate([view.points for view in views]),
            np.concatenate([view.pixels for view in views]),
            np.repeat(np.arange(len(views)), lengths),
            np.concatenate([[0], np.cumsum(lengths)[:-1]]),
            np.repeat(each, lengths),
        )

    def split(self, values: Array) -> tuple[Array, ...]:
        """What is known of every corner, by view."""
        return tuple(np.split(values, self.begins[1:]))


class Solution(Struct, frozen=True, eq=False):
    """A lens with the views' poses, `rotation` (views, 3, 3) and `translation` (views, 3);
    `errors`: measured minus predicted, (n, 2); `cost`: half the weighted, robust sum of squares."""

    camera: CameraModel
    rotation: Array
    translation: Array
    errors: Array
    cost: float

    @property
    def poses(self) -> tuple[Pose, ...]:
        """camera_from_face of every view."""
        pairs = zip(self.rotation, self.translation, strict=True)
        return tuple(Pose(rotation, translation) for rotation, translation in pairs)


def adjusted(
    scene: Scene,
    camera: CameraModel,
    poses: Sequence[Pose],
    *,
    free: Sequence[int] | None = None,
    steps: int = STEPS,
) -> Solution | None:
    """The nearest minimum; `free`: which of the camera's `parameters` are worked out, all where
    left out, none for the poses alone. None where the start puts corners behind the camera."""
    chosen = np.arange(len(camera.parameters)) if free is None else np.array(free, dtype=int)
    turns = np.array([pose.rotation for pose in poses])
    places = np.array([pose.translation for pose in poses])
    scale = _scale_of(scene, camera, turns, places)
    best = None if scale is None else _evaluated(scene, camera, turns, places, scale)
    if best is None or scale is None:
        return None
    damping = _FIRST_DAMPING
    for _ in range(steps):
        equations = _Equations.of(scene, best, chosen, scale)
        improved = None
        while improved is None and damping < _MOST_DAMPING:
            improved = equations.step(damping)
            damping = damping * 10 if improved is None else max(damping / 10, _LEAST_DAMPING)
        if improved is None:
            break
        is_settled = best.cost - improved.cost <= _SAME_COST * best.cost
        best = improved
        # What is usual is learnt anew as the fit gets better; the cost is then another.
        smaller = _usual(best.errors)
        if is_settled and smaller > 0.9 * scale:
            break
        if smaller < 0.9 * scale:
            scale = smaller
            best = _with_cost(scene, best, scale)
    return best


def _scale_of(scene: Scene, camera: CameraModel, turns: Array, places: Array) -> float | None:
    start = _evaluated(scene, camera, turns, places, np.inf)
    return None if start is None else _usual(start.errors)


def _usual(errors: Array) -> float:
    """The standard deviation of a coordinate by the median corner."""
    return max(_MEDIAN_TO_SIGMA * float(np.median(np.abs(errors))), _LEAST_RESIDUAL_PX)


def robust_weights(errors: Array) -> Array:
    """What each corner's square counted in a solution that left these errors (n, 2); (n,)."""
    return _robust_weight(errors, _usual(errors))


def _robust_weight(errors: Array, scale: float) -> Array:
    """Huber's weight of a corner's square, (n,)."""
    far = np.linalg.norm(errors, axis=1) / (_HUBER * scale)
    return 1 / np.maximum(far, 1.0)


def _with_cost(scene: Scene, solution: Solution, scale: float) -> Solution:
    length = np.linalg.norm(solution.errors, axis=1)
    limit = _HUBER * scale
    losses = np.where(length <= limit, 0.5 * length**2, limit * (length - 0.5 * limit))
    if not np.isfinite(limit):
        losses = 0.5 * length**2
    return Solution(
        solution.camera,
        solution.rotation,
        solution.translation,
        solution.errors,
        float(scene.weight @ losses),
    )


def _evaluated(
    scene: Scene, camera: CameraModel, turns: Array, places: Array, scale: float
) -> Solution | None:
    """What a guess costs; None where a corner is not before the camera."""
    points = _in_camera(scene, turns, places)[1]
    if np.any(points[:, 2] < LEAST_DEPTH * np.linalg.norm(points, axis=1)):
        return None
    errors = scene.pixels - camera.project(points)
    if not np.all(np.isfinite(errors)):
        return None
    return _with_cost(scene, Solution(camera, turns, places, errors, 0.0), scale)


def _in_camera(scene: Scene, turns: Array, places: Array) -> tuple[Array, Array]:
    """The corners turned only, and in the optical frame, (n, 3) each."""
    turned = (turns[scene.view] @ scene.points[..., None])[..., 0]
    return turned, turned + places[scene.view]


class _Equations(Struct, frozen=True, eq=False):
    """Normal equations about a solution: of the poses (views, 6, 6) and (views, 6), of the lens
    (p, p) and (p,), and between them (views, 6, p)."""

    scene: Scene
    at: Solution
    free: np.ndarray
    scale: float
    poses: Array
    pose_pull: Array
    between: Array
    lens: Array
    lens_pull: Array

    @classmethod
    def of(cls, scene: Scene, at: Solution, free: np.ndarray, scale: float) -> "_Equations":
        turned, points = _in_camera(scene, at.rotation, at.translation)
        count = len(free)
        rows = np.empty((*at.errors.shape, 6 + count + 1))
        if count:
            _, by_point, by_lens = at.camera.project_jacobians(points)
            rows[..., 6:-1] = by_lens[..., free]
        else:
            _, by_point = at.camera.project_by_point(points)
        rows[..., :3] = by_point
        rows[..., 3], rows[..., 4], rows[..., 5] = _across(turned, by_point)
        rows[..., -1] = at.errors
        rows *= np.sqrt(scene.weight * _robust_weight(at.errors, scale))[:, None, None]
        # One product a view, of all its rows: far quicker than one a corner.
        views = pairwise([*scene.begins.tolist(), len(rows)])
        flat = [rows[begin:end].reshape(-1, rows.shape[-1]) for begin, end in views]
        products = np.array([view.T @ view for view in flat])
        whole = products.sum(axis=0)
        return cls(
            scene,
            at,
            free,
            scale,
            products[:, :6, :6],
            products[:, :6, -1],
            products[:, :6, 6:-1],
            whole[6:-1, 6:-1],
            whole[6:-1, -1],
        )

    def step(self, damping: float) -> Solution | None:
        """A better solution; None where a step under this damping leads to none."""
        lens, poses = _damped(self.lens, damping), _damped(self.poses, damping)
        try:
            eliminated = np.linalg.solve(
                poses, np.concatenate([self.between, self.pose_pull[..., None]], axis=-1)
            )
            by_lens, alone = eliminated[..., :-1], eliminated[..., -1]
            between = self.between.reshape(alone.size, len(self.free))
            reduced = lens - between.T @ by_lens.reshape(between.shape)
            pull = self.lens_pull - between.T @ alone.reshape(-1)
            change = np.linalg.solve(reduced, pull) if len(pull) else pull
        except np.linalg.LinAlgError:
            return None
        moves = alone - by_lens @ change
        parameters = self.at.camera.parameters
        parameters[self.free] += change
        try:
            camera = self.at.camera.with_parameters(parameters)
        except ValueError:  # no focal length is left
            return None
        turns = exp(moves[:, 3:]) @ self.at.rotation
        places = self.at.translation + moves[:, :3]
        found = _evaluated(self.scene, camera, turns, places, self.scale)
        return found if found is not None and found.cost <= self.at.cost else None


def _across(points: Array, rows: Array) -> tuple[Array, Array, Array]:
    """The three components (n, 2) of points (n, 3) × rows (n, 2, 3): `np.cross`, in a fifth of its
    time."""
    (x, y, z), (a, b, c) = points.T[..., None], np.moveaxis(rows, -1, 0)
    return y * c - z * b, z * a - x * c, x * b - y * a


def _damped(matrices: Array, damping: float) -> Array:
    """Marquardt's: each diagonal element larger by a share; (…, k, k)."""
    damped = matrices.copy()
    index = np.arange(matrices.shape[-1])
    damped[..., index, index] *= 1 + damping
    damped[..., index, index] += 1e-12 * np.max(np.abs(matrices), initial=1e-12)
    return damped
