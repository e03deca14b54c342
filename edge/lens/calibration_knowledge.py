"""How well a fit knows its lens: sigmas that hold from one set of pictures to the next.

Corners that scatter are the least of it. What views have in common besides the lens, above all a
board that is not flat, moves all corners of a view together, so views are what is counted:

- Views that show the board in one place count as one (`looks`).
- Where views pull apart by more than their corners scatter, sigmas grow with that: on average over
  all parameters, and for each one by what leaving out each look changes (the jackknife, to first
  order; Efron and Stein, 1981). Between halves of real sets differences are then 0.5 to 1 sigma.
- A bow of the board is the same in all views, so no two halves disagree about it: it is counted as
  three unknowns with a prior. Boards that were never tilted tell of it and of the focal length
  together.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array

from .bundle_adjustment import robust_weights
from .calibration_fit import Fit, pose_jacobian
from .calibration_information import without_pose
from .calibration_views import View

# How far out of its plane a board's rim may be, of its half diagonal: half a millimetre of A4.
BOW_SHARE = 0.003
_BOWS = 3
_LEAST = 1e-15
# With hardly more looks than unknowns the correction for few looks says nothing any more.
_MOST_SMALL_SAMPLE = 2.0


class Knowledge(Struct, frozen=True, eq=False):
    """`sigma`: of the camera's `parameters`, (p,); `noise_px`: of one coordinate, from the
    residuals; `disagreement`: by how much views differ more than corners scatter (1: not at all; a
    bent board makes it 2 or 3). `sigma` is with that."""

    sigma: Array
    noise_px: float
    disagreement: float


def knowledge(found: Fit, views: Sequence[View], looks: np.ndarray | None = None) -> Knowledge:
    """Sigmas of a fit; `looks`: (views,) which views are alike and count as one, none where left
    out. Raises ValueError where the views leave the lens undetermined."""
    noise = _noise_of(found, views)
    information, pulls = _by_look(found, views, looks)
    count = len(found.camera.parameters)
    lens = information[:, :count, :count]
    covariance = _inverse(lens.sum(axis=0))
    disagreement = _disagreement(lens, pulls / noise, covariance)
    usual = _with_bow(information.sum(axis=0) / (disagreement * noise) ** 2, count)
    scatter = noise**2 * np.diag(covariance)
    # A jackknife of few looks is too large by itself.
    usual = scatter + np.maximum(usual - scatter, 0.0) * _small_sample(len(lens), count)
    variance = np.maximum(usual, _jackknifed(lens, pulls))
    return Knowledge(np.sqrt(variance), noise, disagreement)


def _small_sample(looks: int, unknowns: int) -> float:
    """By how much what looks say of each other is too little, since the lens was fitted to them."""
    return min(looks / max(looks - unknowns, 1), _MOST_SMALL_SAMPLE)


def look_weights(looks: np.ndarray) -> Array:
    """What each view counts, (views,): those that are alike count as one together."""
    _, groups, counts = np.unique(looks, return_inverse=True, return_counts=True)
    return 1.0 / counts[groups]


def _noise_of(found: Fit, views: Sequence[View]) -> float:
    """The standard deviation of a coordinate; raises ValueError where nothing is left of it."""
    errors = np.concatenate([error.reshape(-1) for error in found.errors])
    freedom = len(errors) - 6 * len(views) - len(found.camera.parameters)
    if freedom <= 0:
        raise ValueError("there are fewer corners than unknowns")
    return float(np.sqrt(np.sum(errors**2) / freedom))


def _by_look(found: Fit, views: Sequence[View], looks: np.ndarray | None) -> tuple[Array, Array]:
    """Each look's information about the lens and the board's bow, (looks, p + 3, p + 3), for
    corners of 1 px, and its pull on the lens (looks, p): the means over its views."""
    looks = np.arange(len(views)) if looks is None else looks
    groups, weights = np.unique(looks, return_inverse=True)[1], look_weights(looks)
    count = len(found.camera.parameters)
    information = np.zeros((groups.max() + 1, count + _BOWS, count + _BOWS))
    pulls = np.zeros((groups.max() + 1, count))
    root = np.sqrt(robust_weights(np.concatenate(found.errors)))
    roots = np.split(root, np.cumsum([len(view) for view in views])[:-1])
    for i, (pose, view, error) in enumerate(
        zip(found.camera_from_face, views, found.errors, strict=True)
    ):
        by_pose, by_lens = pose_jacobian(found.camera, pose, view)
        by_depth = by_pose[:, :3] @ pose.rotation[:, 2]
        by_all = np.hstack([by_lens, by_depth[:, None] * np.repeat(_bows(view), 2, axis=0)])
        each = np.repeat(roots[i], 2)
        told, pull = without_pose(
            by_pose * each[:, None], by_all * each[:, None], error.reshape(-1) * each
        )
        information[groups[i]] += weights[i] * told
        pulls[groups[i]] += weights[i] * pull[:count]
    return information, pulls


def _bows(view: View) -> Array:
    """Three bows, (n, 3): along the board, across it and askew, each as deep at the rim as is
    usual, metres."""
    middle = (view.points.max(axis=0) + view.points.min(axis=0)) / 2
    x, y = ((view.points - middle)[:, :2]).T
    half = float(np.hypot(x, y).max())
    return BOW_SHARE * half * np.column_stack([x * x, y * y, 2 * x * y]) / half**2


def _with_bow(information: Array, count: int) -> Array:
    """Variances of the lens (p,) with the bow unknown but for its prior of 1."""
    prior = np.zeros(len(information))
    prior[count:] = 1.0
    return np.diag(_inverse(information + np.diag(prior)))[:count]


def _jackknifed(information: Array, pulls: Array) -> Array:
    """Variances (p,) by what each look, left out, would change, to first order."""
    if len(information) < 3:
        return np.zeros(pulls.shape[1])
    total = information.sum(axis=0)
    changes = np.array(
        [_inverse(total - own) @ pull for own, pull in zip(information, pulls, strict=True)]
    )
    return (1 - 1 / len(changes)) * np.sum(changes**2, axis=0)


def _disagreement(information: Array, pulls: Array, covariance: Array) -> float:
    """How much stronger the views pull apart than their corners' scatter (`pulls` in its units)
    lets them, on average over all parameters; never below 1.

    Under white noise view v's pull has the covariance I_v − I_v C I_v: it has pulled the solution
    towards itself (the correction that makes cluster-robust covariances unbiased; Bell and
    McCaffrey, 2002).
    """
    own = information @ covariance
    expected = len(covariance) - float(np.einsum("vij,vji->", own, own))
    if expected < 1:
        return 1.0
    found = float(np.einsum("vi,ij,vj->", pulls, covariance, pulls))
    return float(np.sqrt(max(1.0, found / expected)))


def _inverse(information: Array) -> Array:
    """The inverse, large but finite where coefficients can stand in for each other, as those of the
    rational model do on a lens that needs few of them."""
    diagonal = np.diag(information)
    if not np.all(diagonal > 0):
        raise ValueError("the views do not determine the lens")
    scale = 1 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    inverse = (vectors / np.maximum(values, _LEAST * values[-1])) @ vectors.T
    return inverse * scale[:, None] * scale
