"""What a set of pictures leaves open about a lens, by name, with what to do about it.

Whoever reads the file takes the lens as known, so what the pictures do not tell must be said.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .bundle_adjustment import Scene, adjusted
from .calibration_fit import Fit
from .calibration_knowledge import Knowledge, look_weights
from .calibration_views import View

# Zhang's method needs three views of different slant; with one more they can be held against each
# other.
FEWEST_LOOKS = 4
# A sigma from which a number is as good as not known: of the focal length, by which every distance
# is off as well; of the principal point, by the picture's width, as a site supposes it unseen.
OPEN_FOCAL, OPEN_CENTRE = 0.05, 0.05
# A focal length so many times larger or smaller must explain the views worse by so many units of
# chi squared (3 sigmas of one unknown): where errors are large, sigmas at one place mislead.
_OTHER_FOCALS = (0.8, 1.25)
_LEAST_WORSE = 9.0
# Residuals of a coordinate beyond this share of the picture's diagonal are of no lens: 1.6 px of
# 1280 × 960, four times what real sets of flexible boards leave.
_MOST_RESIDUAL = 1e-3
# Slants that differ by less are one, degrees; boards that were to be held straight on vary by 5.
_SAME_SLANT_DEG = 12.0


class Doubt(Struct, frozen=True):
    """`what` is not determined: `why`, and what to `do`."""

    what: str
    why: str
    do: str

    def __str__(self) -> str:
        return f"{self.what}: {self.why}; {self.do}"


def doubts(
    found: Fit, known: Knowledge, views: Sequence[View], looks: np.ndarray
) -> tuple[Doubt, ...]:
    """What these views do not determine; none where the lens can be trusted."""
    count = int(looks.max()) + 1
    if count < FEWEST_LOOKS:
        return (_too_few_looks(len(views), count),)
    camera, sigma = found.camera, known.sigma
    said = []
    if known.noise_px > _MOST_RESIDUAL * np.hypot(camera.width, camera.height):
        said.append(_no_lens(known.noise_px))
    if (
        sigma[0] > OPEN_FOCAL * camera.fx
        or sigma[1] > OPEN_FOCAL * camera.fy
        or not _holds_against_others(found, known, views, look_weights(looks))
    ):
        said.append(_focal(found))
    if max(sigma[2:4]) > OPEN_CENTRE * camera.width:
        said.append(_centre(found))
    return tuple(said)


def _too_few_looks(pictures: int, count: int) -> Doubt:
    shown = "one view" if count == 1 else f"{count} different views"
    return Doubt(
        "focal length, principal point and distortion",
        f"{pictures} views of the board show {shown} of it, as those that are alike count as one",
        f"show it in at least {FEWEST_LOOKS} places, better 20, slanted to all sides",
    )


def _no_lens(noise_px: float) -> Doubt:
    return Doubt(
        "lens",
        f"no model explains the views, {noise_px:.1f} px a coordinate are left",
        "see that all pictures are of one camera with fixed focus and zoom, that the target file "
        "describes the board, and that the board is flat",
    )


def _focal(found: Fit) -> Doubt:
    slants = _slants(found)
    if _spread_deg(slants, np.array([0.0, 0.0, 1.0])) < _SAME_SLANT_DEG:
        why = "the board was never tilted"
    elif _spread_deg(slants, slants.mean(axis=0)) < _SAME_SLANT_DEG:
        why = "the board was always tilted the same way"
    else:
        why = "the board was tilted too little, or is too small in the pictures"
    return Doubt(
        "focal length", why, "add pictures with it slanted by 30 to 45 degrees to all sides, near"
    )


def _centre(found: Fit) -> Doubt:
    slants = _slants(found)
    if _spread_deg(slants, slants.mean(axis=0)) < _SAME_SLANT_DEG:
        why = "the board was always tilted the same way"
    else:
        why = "the board was seen in too small a part of the picture"
    return Doubt(
        "principal point", why, "add pictures with it slanted to all sides, in every corner"
    )


def _slants(found: Fit) -> Array:
    """The boards' normals in the optical frame, (views, 3)."""
    return np.array([pose.rotation[:, 2] for pose in found.camera_from_face])


def _spread_deg(normals: Array, about: Array) -> float:
    """How far nine tenths of the normals are from a direction at most, degrees."""
    along = normals @ about / np.linalg.norm(about)
    return float(np.degrees(np.quantile(np.arccos(np.clip(along, -1.0, 1.0)), 0.9)))


def _holds_against_others(
    found: Fit, known: Knowledge, views: Sequence[View], weights: Array
) -> bool:
    """Whether lenses of quite another focal length explain the views worse, each at its best."""
    scene, unit = Scene.of(views, weights), (known.disagreement * known.noise_px) ** 2
    parameters = found.camera.parameters
    others = [index for index in range(len(parameters)) if index > 1]
    best = adjusted(scene, found.camera, found.camera_from_face, free=(), steps=2)
    if best is None:
        return True
    far = 3 * 1.4826 * float(np.median(np.linalg.norm(best.errors, axis=1)))
    least = _chi2(best.errors, scene, far) + _LEAST_WORSE * unit
    for factor in _OTHER_FOCALS:
        moved = parameters.copy()
        moved[:2] *= factor
        camera = found.camera.with_parameters(moved)
        nearer = [
            Pose(pose.rotation, pose.translation * np.array([1.0, 1.0, factor]))
            for pose in found.camera_from_face
        ]
        other = adjusted(scene, camera, nearer, free=others)
        if other is not None and _chi2(other.errors, scene, far) < least:
            return False
    return True


def _chi2(errors: Array, scene: Scene, far: float) -> float:
    """The weighted sum of squares, where none is more than `far` off."""
    return float(scene.weight @ np.minimum(np.linalg.norm(errors, axis=1), far) ** 2)
