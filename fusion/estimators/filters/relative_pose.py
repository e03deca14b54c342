"""A sighting as a measurement of camera_from_base: all that a picture says of camera and robot.

The corners' residuals depend on camera_from_base alone, so that the least-squares problem over a
hundred corners reduces to six equations: with the thin QR factorisation J = Q R of their weighted
Jacobian, |r + J d|² = |Qᵀr + R d|² + what no pose explains (Golub and Van Loan, «Matrix
Computations», section 5.3). Both filters use this as their measurement.
"""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.association.sightings import all_without_wild
from trigpoint.fusion.model.gates import WILD_CORNER_SIGMAS, WILD_SHARE
from trigpoint.fusion.model.observations import Observation, base_from_faces, points_of
from trigpoint.fusion.model.projection import projected
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import turned_axes
from trigpoint.site.target import Target

_LEAST_CORNERS = 4
# A sighting determines a pose where the weakest direction is known at least this much, relative to
# the best known one.
_DETERMINED = 1e-7


class RelativeView(Struct, frozen=True):
    """A sighting linearised about `camera_from_base`.

    A disturbance d (6,) of that pose costs |residual + root d|², unit noise each; `root`: (6, 6),
    `residual`: (6,). `left_over`: χ² that no pose explains, with `freedom` degrees of freedom;
    `rms_px`: the RMS of a used coordinate.
    """

    camera_from_base: Pose
    root: Array
    residual: Array
    left_over: float
    freedom: int
    rms_px: float

    @property
    def determines_pose(self) -> bool:
        """Whether the sighting alone determines the robot's pose relative to the camera."""
        strength = np.linalg.svd(self.root, compute_uv=False)
        return len(self.root) == 6 and bool(strength[-1] >= _DETERMINED * strength[0])


def relative_view(
    observation: Observation,
    target: Target,
    lens: CameraModel,
    camera_from_base: Pose,
    variances: Array | None = None,
) -> RelativeView | None:
    """The view of a read observation at a pose; None where a corner lies behind the camera or too
    few are left. `variances` (6,): of the robot's deviation in this picture, along and about its
    own axes."""
    points = points_of(observation, target)
    used = points.weights > 0
    found = projected(lens, camera_from_base, points.in_base(base_from_faces(target))[used])
    if not np.all(found.is_ahead) or used.sum() < _LEAST_CORNERS:
        return None
    weights = points.weights[used][:, None]
    apart = found.pixels - points.pixels[used]
    jacobian = (found.by_body * weights[..., None]).reshape(2 * len(apart), 6)
    residual = (apart * weights).reshape(-1)
    if not (np.all(np.isfinite(jacobian)) and np.all(np.isfinite(residual))):
        return None
    basis, root = np.linalg.qr(jacobian)
    compressed = basis.T @ residual
    left = max(float(residual @ residual - compressed @ compressed), 0.0)
    freedom, rms_px = len(residual) - 6, float(np.sqrt(np.mean(apart**2)))
    if variances is not None:  # they add to the noise of what the corners measure
        by_base = root @ turned_axes(camera_from_base.rotation)
        spread = np.eye(len(root)) + by_base * variances @ by_base.T
        whitening = np.linalg.inv(np.linalg.cholesky(spread))
        root, compressed = whitening @ root, whitening @ compressed
    return RelativeView(camera_from_base, root, compressed, left, freedom, rms_px)


def without_wild_corners(
    observation: Observation, target: Target, lens: CameraModel, camera_from_base: Pose
) -> Observation | None:
    """Mark the corners of an observation that no nearby pose explains as outliers.

    None where there are too many outliers, or nothing is left to fit.
    """
    points = points_of(observation.with_outliers(()), target)
    found = projected(lens, camera_from_base, points.in_base(base_from_faces(target)))
    if not np.all(found.is_ahead):
        return None
    weights = points.weights[:, None]
    by_pose, residual = found.by_body * weights[..., None], (found.pixels - points.pixels) * weights
    _, (wild,) = all_without_wild(by_pose[None], residual[None], WILD_CORNER_SIGMAS**2)
    is_wrong = wild.mean() > WILD_SHARE or np.sum(~wild) < _LEAST_CORNERS
    return None if is_wrong else observation.marked(wild)
