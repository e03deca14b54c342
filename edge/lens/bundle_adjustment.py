"""Least squares over a lens and the poses of the views that were taken through it.

Levenberg-Marquardt steps with the poses eliminated (Triggs et al., «Bundle Adjustment: A Modern
Synthesis», 2000). Our own, since OpenCV's has one start a model: on a fisheye lens it ends at 4 px
where the pictures allow 0.2, and it takes no weights.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

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
    `turned`, `points`: the corners turned only, and in the optical frame, (n, 3) each; `errors`:
    measured minus predicted, (n, 2); `cost`: half the weighted, robust sum of squares."""

    camera: CameraModel
    rotation: Array
    translation: Array
    turned: Array
    points: Array
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
    best = _evaluated(scene, camera, turns, places, np.inf)
    if best is None:
        return None
    scale = _usual(best.errors)
    best = replace(best, cost=_cost(scene, best.errors, scale))
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
            best = replace(best, cost=_cost(scene, best.errors, scale))
    return best


def _usual(errors: Array) -> float:
    """The standard deviation of a coordinate by the median corner."""
    # Of so few numbers `np.median` takes five times as long.
    below, above = np.sort(np.abs(errors), axis=None)[len(errors) - 1 : len(errors) + 1].tolist()
    return max(_MEDIAN_TO_SIGMA * (below + above) / 2, _LEAST_RESIDUAL_PX)


def robust_weights(errors: Array) -> Array:
    """What each corner's square counted in a solution that left these errors (n, 2); (n,)."""
    return _robust_weight(errors, _usual(errors))


def _robust_weight(errors: Array, scale: float) -> Array:
    """Huber's weight of a corner's square, (n,)."""
    far = np.hypot(*errors.T) / (_HUBER * scale)
    return 1 / np.maximum(far, 1.0)


def _cost(scene: Scene, errors: Array, scale: float) -> float:
    length = np.hypot(*errors.T)
    near = np.minimum(length, _HUBER * scale)
    return float(scene.weight @ (near * (length - 0.5 * near)))


def _evaluated(
    scene: Scene, camera: CameraModel, turns: Array, places: Array, scale: float
) -> Solution | None:
    """What a guess costs; None where a corner is not before the camera."""
    turned = np.einsum("nij,nj->ni", turns[scene.view], scene.points)
    points = turned + places[scene.view]
    if not are_before(points):
        return None
    errors = scene.pixels - camera.project(points)
    if not np.isfinite(errors).all():
        return None
    cost = _cost(scene, errors, scale)
    return Solution(camera, turns, places, turned, points, errors, cost)


def are_before(points: Array) -> bool:
    """Whether all points (n, 3) lie before the camera."""
    least = LEAST_DEPTH * np.sqrt(np.einsum("ni,ni->n", points, points))
    return bool((points[:, 2] > least).all())


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
        count = len(free)
        rows = np.empty((*at.errors.shape, 6 + count + 1))
        if count:
            _, by_point, by_lens = at.camera.project_jacobians(at.points)
            rows[..., 6:-1] = by_lens[..., free]
        else:
            _, by_point = at.camera.project_by_point(at.points)
        rows[..., :3] = by_point
        rows[..., 3], rows[..., 4], rows[..., 5] = _across(at.turned, by_point)
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
        camera = self.at.camera
        try:
            eliminated = np.linalg.solve(
                _damped(self.poses, damping),
                np.concatenate([self.between, self.pose_pull[..., None]], axis=-1),
            )
            by_lens, moves = eliminated[..., :-1], eliminated[..., -1]
            if len(self.free):
                between = self.between.reshape(moves.size, len(self.free))
                reduced = _damped(self.lens, damping) - between.T @ by_lens.reshape(between.shape)
                change = np.linalg.solve(reduced, self.lens_pull - between.T @ moves.reshape(-1))
                moves = moves - by_lens @ change
                parameters = camera.parameters
                parameters[self.free] += change
                camera = camera.with_parameters(parameters)
        except (np.linalg.LinAlgError, ValueError):  # or no focal length is left
            return None
        # One by one: most calls are of one view, and of that an array takes seven times as long.
        turns = np.array([exp(turn) for turn in moves[:, 3:]]) @ self.at.rotation
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
