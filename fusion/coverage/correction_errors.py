"""How far off a robot's corrected position is expected to be, by the pictures of several cameras.

A picture of camera i measures the disturbance δ of the robot's pose, as far as the camera stands
where it is thought to stand: z_i = E δ - L_i c_i + n_i, with E the free components of δ, c_i the
error of the camera's pose, L_i what that does at the robot (`geometry.uncertainty.lever`) and n_i
the corners' noise, of the picture's inverse information. The c_i are correlated, by the network's
joint covariance. With Σ the covariance of all z_i together and M its inverse, the information on δ
is I = Σ_ij Eᵀ M_ij E, and without camera i it is I - T_iᵀ M_ii⁻¹ T_i, T_i = Σ_j M_ij E (block
elimination). That is what a filter that knows the network makes of pictures of a robot of which it
knows nothing else; what odometry knows is not counted.
"""

from functools import cache

import numpy as np
from msgspec import Struct

from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever, symmetric

SHARE = 0.95
"""Of the errors lie within the stated radius."""
MOST_CAMERAS = 6
"""So many cameras' pictures are combined, the best of those that see a robot."""
_AT_ONCE = 4096
# Of the information in its own direction, what is left to a component that the others leave open.
_OPEN = 1e-11


class Pictures(Struct, frozen=True, eq=False):
    """Pictures (p,) of a robot at poses: which `pose` and which `camera` by number, in order of
    the poses; their `information` (p, 6, 6) on the pose's disturbance; and the vector from the
    camera to the robot's base, `arm` (p, 3), in the map."""

    pose: np.ndarray
    camera: np.ndarray
    information: Array
    arm: Array

    def where(self, chosen: np.ndarray) -> "Pictures":
        return Pictures(
            self.pose[chosen], self.camera[chosen], self.information[chosen], self.arm[chosen]
        )


class Errors(Struct, frozen=True, eq=False):
    """Radii within which 95 % of the errors of a position lie, metres; inf where nothing corrects.

    `by_pose` (n,): by all pictures at a pose; `without` (p,): without a picture's camera.
    """

    by_pose: Array
    without: Array


def expected_errors(
    pictures: Pictures, poses: int, covariance: Array, tangent: tuple[int, ...]
) -> Errors:
    """The errors at so many poses; `covariance` (6n, 6n): the joint one of all cameras."""
    by_pose, without = np.full(poses, np.inf), np.full(len(pictures.pose), np.inf)
    if not len(pictures.pose):
        return Errors(by_pose, without)
    single = _Singles.of(pictures, covariance, tangent)
    used = _best(pictures.pose, radius(single.position))
    counts = np.bincount(pictures.pose[used], minlength=poses)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    for count in range(1, int(counts.max(initial=0)) + 1):
        alike = np.flatnonzero(counts == count)
        for start in range(0, len(alike), _AT_ONCE):
            some = alike[start : start + _AT_ONCE]
            rows = used[starts[some, None] + np.arange(count)]
            whole, parts = _combined(single, rows, covariance)
            by_pose[some], without[rows] = radius(whole), radius(parts)
    # A picture that is not used can be done without.
    spare = np.ones(len(without), dtype=bool)
    spare[used] = False
    without[spare] = by_pose[pictures.pose[spare]]
    return Errors(by_pose, without)


def _best(pose: np.ndarray, alone_m: Array) -> np.ndarray:
    """The pictures (p,) that are combined: of each pose at most so many, and none that says nothing
    by itself; in order."""
    order = np.lexsort([alone_m, pose])
    is_first = np.concatenate([[True], np.diff(pose[order]) > 0])
    here = np.arange(len(order))
    rank = here - np.maximum.accumulate(np.where(is_first, here, 0))
    kept = order[(rank < MOST_CAMERAS) & np.isfinite(alone_m[order])]
    return np.sort(kept)


def _combined(single: "_Singles", rows: np.ndarray, covariance: Array) -> tuple[Array, Array]:
    """The covariance of the position (g, 2, 2) by m pictures each, `rows` (g, m), and without each
    of them (g, m, 2, 2)."""
    groups, count = rows.shape
    if count == 1:
        return single.position[rows[:, 0]], np.full((groups, 1, 2, 2), np.inf)
    inverse = np.linalg.inv(_together(single, rows, covariance))
    inverse = inverse.reshape(groups, count, 6, count, 6)
    free = list(single.tangent)
    summed = inverse[..., free].sum(axis=3)  # T_i, (g, m, 6, k)
    information = summed[:, :, free].sum(axis=1)
    own = np.einsum("gikil->gikl", inverse)
    less = np.swapaxes(summed, 2, 3) @ np.linalg.solve(own, summed)
    return _position(information), _position(information[:, None] - less)


def _together(single: "_Singles", rows: np.ndarray, covariance: Array) -> Array:
    """Σ of pictures `rows` (g, m), (g, 6 m, 6 m)."""
    groups, count = rows.shape
    joint = np.empty((groups, count, 6, count, 6))
    for i in range(count):
        joint[:, i, :, i] = single.own[rows[:, i]]
        for j in range(i):
            columns = 6 * single.camera[rows[:, [i, j]]][..., None] + np.arange(6)
            between = covariance[columns[:, 0, :, None], columns[:, 1, None, :]]
            across = single.levers[rows[:, i]] @ between
            across = across @ np.swapaxes(single.levers[rows[:, j]], 1, 2)
            joint[:, i, :, j] = across
            joint[:, j, :, i] = np.swapaxes(across, 1, 2)
    return joint.reshape(groups, 6 * count, 6 * count)


class _Singles(Struct, frozen=True, eq=False):
    """What each picture (p,) says by itself: the covariance of its z, `own` (p, 6, 6); by it the
    `position`'s (p, 2, 2); `levers` (p, 6, 6): L. `tangent`: the free components."""

    camera: np.ndarray
    tangent: tuple[int, ...]
    own: Array
    position: Array
    levers: Array

    @classmethod
    def of(cls, pictures: Pictures, covariance: Array, tangent: tuple[int, ...]) -> "_Singles":
        """With Q = L P Lᵀ and A the picture's information, the covariance of z is Q + A⁻¹, and its
        inverse (1 + A Q)⁻¹ A, also where A leaves something open."""
        columns = 6 * pictures.camera[:, None] + np.arange(6)
        levers = lever(pictures.arm)
        moved = levers @ covariance[columns[:, :, None], columns[:, None, :]]
        moved = moved @ np.swapaxes(levers, 1, 2)
        weight = np.linalg.solve(np.eye(6) + pictures.information @ moved, pictures.information)
        free = list(tangent)
        own = symmetric(moved + _noise(pictures.information))
        return cls(pictures.camera, tangent, own, _position(weight[:, free][..., free]), levers)


def _noise(information: Array) -> Array:
    """The covariance (p, 6, 6) of what pictures measure; very large where one leaves a direction
    open."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("pii->pi", information), 1e-30))
    scaled = information * scale[:, :, None] * scale[:, None, :] + _OPEN * np.eye(6)
    return np.linalg.inv(scaled) * scale[:, :, None] * scale[:, None, :]


def _position(information: Array) -> Array:
    """The covariance of x and y (…, 2, 2); infinite where the information does not give it."""
    return _inverse(information)[..., :2, :2]


def _inverse(information: Array) -> Array:
    """The inverse of information matrices (…, k, k); infinite where there is none."""
    diagonal = np.einsum("...ii->...i", information)
    is_known = np.all(diagonal > 0, axis=-1)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = symmetric(information * scale[..., :, None] * scale[..., None, :])
    inverse, determinant = _adjugate(scaled) if scaled.shape[-1] == 3 else _factored(scaled)
    is_known &= determinant > _OPEN
    covariance = inverse * scale[..., :, None] * scale[..., None, :]
    return np.where(is_known[..., None, None], covariance, np.inf)


def _adjugate(matrix: Array) -> tuple[Array, Array]:
    """The inverse of symmetric matrices (…, 3, 3) and their determinant, by cross products: many
    small matrices at once are several times faster so."""
    rows = [np.cross(matrix[..., i - 2, :], matrix[..., i - 1, :]) for i in range(3)]
    determinant = np.sum(matrix[..., 0, :] * rows[0], axis=-1)
    safe = np.where(determinant > _OPEN, determinant, 1.0)
    return np.stack(rows, axis=-1) / safe[..., None, None], determinant


def _factored(matrix: Array) -> tuple[Array, Array]:
    """The inverse of symmetric matrices (…, k, k) and their determinant."""
    determinant = np.linalg.det(matrix)
    is_open = ~(determinant > _OPEN)
    safe = np.where(is_open[..., None, None], np.eye(matrix.shape[-1]), matrix)
    return np.linalg.inv(safe), determinant


def radius(covariance: Array) -> Array:
    """The radius about a position in the plane within which its error lies with 95 %, by its
    covariance (…, 2, 2); inf where that is not finite."""
    xx, yy, xy = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    is_known = np.isfinite(xx) & np.isfinite(yy) & np.isfinite(xy)
    xx, yy, xy = (np.where(is_known, part, 1.0) for part in (xx, yy, xy))
    middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    largest = np.sqrt(np.maximum(middle + apart, 0.0))
    smallest = np.sqrt(np.maximum(middle - apart, 0.0))
    shape = smallest / np.maximum(largest, 1e-300)
    ratios, factors = _factors()
    return np.where(is_known, largest * np.interp(shape, ratios, factors), np.inf)


@cache
def _factors() -> tuple[Array, Array]:
    """The radius in units of the longer axis's sigma, by the ratio of the two sigmas: 1.960 on a
    line to 2.448 in a circle.

    With (x, y) = r (cos φ, q sin φ), φ is uniform and r²/2 exponentially distributed, so that
    P(√(x² + y²) > R) is the mean of exp(-R²/2 / (cos²φ + q² sin²φ)) over a quarter of a turn
    (Craig, 1991, for q = 0); by bisection.
    """
    ratios = np.linspace(0.0, 1.0, 201)
    angles = (np.arange(100) + 0.5) * np.pi / 200
    half = 0.5 / (np.cos(angles) ** 2 + (ratios[:, None] * np.sin(angles)) ** 2)
    low, high = np.full(len(ratios), 1.9), np.full(len(ratios), 2.5)
    for _ in range(40):
        reach = 0.5 * (low + high)
        is_less = np.exp(-half * reach[:, None] ** 2).mean(axis=1) > 1 - SHARE
        low, high = np.where(is_less, reach, low), np.where(is_less, high, reach)
    return ratios, 0.5 * (low + high)
