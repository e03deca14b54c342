"""One lens model fitted to views, and how well a lens fits other views."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.camera import LensModel
from trigpoint.geometry.rotation import Array, hat

from .bundle_adjustment import STEPS, Scene, Solution, adjusted
from .calibration_start import equidistant_start, polynomial_from, pose_through
from .calibration_views import View

_SEEN = 0.99
_POSE_STEPS = 20


class Fit(Struct, frozen=True, eq=False):
    """A camera and where each view's face was; `errors`: measured minus predicted, (n, 2) each."""

    camera: CameraModel
    camera_from_face: tuple[Pose, ...]
    errors: tuple[Array, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square of a corner's distance from its prediction, as OpenCV and ROS say it."""
        squares = np.concatenate([np.sum(error**2, axis=1) for error in self.errors])
        return float(np.sqrt(squares.mean()))

    @property
    def view_rms_px(self) -> Array:
        """The same of every view, (views,)."""
        return np.array([np.sqrt(np.mean(np.sum(error**2, axis=1))) for error in self.errors])


class Placed(Struct, frozen=True, eq=False):
    """Where a view's face was; `error`: measured minus predicted, (n, 2)."""

    camera_from_face: Pose
    error: Array

    @property
    def rms_px(self) -> float:
        """Root mean square of a corner's distance from its prediction."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))


def fit(
    model: LensModel,
    views: Sequence[View],
    size: tuple[int, int],
    *,
    start: Fit | None = None,
    weights: Array | None = None,
    steps: int = STEPS,
) -> Fit | None:
    """The least-squares fit of a model; `size`: width, height; `start`: a fit of any model to the
    same views; `weights`: (views,), of each view; `steps`: how many at most. None where
    there is no such lens, or it folds back within the picture."""
    if start is None:
        first = equidistant_start(views, size)
        if first is None:
            return None
        placed = [place(first.camera, view) for view in views]
        if any(one is None for one in placed):
            return None
        sound = [one for one in placed if one is not None]
        start = Fit(
            first.camera,
            tuple(one.camera_from_face for one in sound),
            tuple(one.error for one in sound),
        )
    scene = Scene.of(views, weights)
    poses = start.camera_from_face
    found = [adjusted(scene, lens, poses, steps=steps) for lens in _starts(model, start, views)]
    best = min((one for one in found if one), key=lambda one: one.cost, default=None)
    if best is None or not _is_unfolded(best, views):
        return None
    return _fit_of(best, views)


def place(camera: CameraModel, view: View) -> Placed | None:
    """Another view under a lens that is given: only its pose is fitted. None where the lens leads
    to no such pixels."""
    pose = pose_through(camera, view)
    if pose is None:
        return None
    found = adjusted(Scene.of([view]), camera, [pose], free=(), steps=_POSE_STEPS)
    return None if found is None else Placed(found.poses[0], found.errors)


def pose_jacobian(camera: CameraModel, pose: Pose, view: View) -> tuple[Array, Array]:
    """Derivatives of the view's pixels, row by row, by the pose, (2n, 6), and by the camera's
    `parameters`, (2n, p); the pose's disturbance is the contract's."""
    turned = view.points @ pose.rotation.T
    _, by_point, by_parameters = camera.project_jacobians(turned + pose.translation)
    by_turn = -by_point @ hat(turned)
    by_pose = np.concatenate([by_point, by_turn], axis=-1).reshape(-1, 6)
    return by_pose, by_parameters.reshape(len(by_pose), -1)


def _starts(model: LensModel, start: Fit, views: Sequence[View]) -> list[CameraModel]:
    """Where to begin: the start itself, or polynomials of its profile and of none."""
    camera = start.camera
    if camera.model is model:
        return [camera]
    plain = CameraModel(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, (), model
    )
    if camera.model is not LensModel.EQUIDISTANT:
        return [plain]
    pixels = np.concatenate([view.pixels for view in views])
    return [polynomial_from(camera, model, pixels), plain]


def _fit_of(found: Solution, views: Sequence[View]) -> Fit:
    return Fit(found.camera, found.poses, Scene.of(views).split(found.errors))


def _is_unfolded(found: Solution, views: Sequence[View]) -> bool:
    """Whether the lens puts what was seen into the picture, short of where it folds back."""
    seen = [
        found.camera.sees(pose @ view.points) for pose, view in zip(found.poses, views, strict=True)
    ]
    return bool(np.mean(np.concatenate(seen)) > _SEEN)
