"""Rotations in space: matrices, rotation vectors, quaternions (x, y, z, w).

Every function takes any number of leading dimensions. Formulae: Solà, Deray and Atchuthan,
«A micro Lie theory for state estimation in robotics» (2018), section on SO(3).
"""

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating[Any]]
_Number = TypeVar("_Number", float, Array)

_SMALL_SQUARED = 1e-8


def hat(vector: ArrayLike) -> Array:
    """Return the matrix of the cross product: `hat(a) @ b == cross(a, b)`; (…, 3) -> (…, 3, 3)."""
    v = np.asarray(vector, dtype=float)
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1] = -v[..., 2]
    matrix[..., 0, 2] = v[..., 1]
    matrix[..., 1, 0] = v[..., 2]
    matrix[..., 1, 2] = -v[..., 0]
    matrix[..., 2, 0] = -v[..., 1]
    matrix[..., 2, 1] = v[..., 0]
    return matrix


def exp(rotation_vector: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector, radians; (…, 3) -> (…, 3, 3) (Rodrigues)."""
    v = np.asarray(rotation_vector, dtype=float)
    if v.ndim == 1:
        return _one_rotation(*v.tolist())
    squared = np.sum(v * v, axis=-1)[..., None, None]
    small = squared < _SMALL_SQUARED
    angle = np.sqrt(np.where(small, 1.0, squared))
    sine = np.where(small, 1 - squared / 6, np.sin(angle) / angle)
    versine = np.where(small, 0.5 - squared / 24, (1 - np.cos(angle)) / angle**2)
    cross = hat(v)
    return np.eye(3) + sine * cross + versine * (cross @ cross)


def _one_rotation(x: float, y: float, z: float) -> Array:
    """`exp` of a single vector, which every estimate needs: a tenth of the time."""
    squared = x * x + y * y + z * z
    if squared < _SMALL_SQUARED:
        sine, versine = 1 - squared / 6, 0.5 - squared / 24
    elif not math.isfinite(squared):
        return np.full((3, 3), np.nan)
    else:
        angle = math.sqrt(squared)
        sine, versine = math.sin(angle) / angle, (1 - math.cos(angle)) / squared
    xx, yy, zz = versine * x * x, versine * y * y, versine * z * z
    xy, xz, yz = versine * x * y, versine * x * z, versine * y * z
    x, y, z = sine * x, sine * y, sine * z
    return np.array(
        (
            (1 - yy - zz, xy - z, xz + y),
            (xy + z, 1 - xx - zz, yz - x),
            (xz - y, yz + x, 1 - xx - yy),
        )
    )


def log(matrix: ArrayLike) -> Array:
    """Rotation vector of a rotation matrix, of length at most π; (…, 3, 3) -> (…, 3)."""
    quaternion = to_quaternion(matrix)
    vector, scalar = quaternion[..., :3], quaternion[..., 3:]
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    small = length < 1e-9
    angle = 2 * np.arctan2(length, scalar)
    return vector * np.where(small, 2.0, angle / np.where(small, 1.0, length))


def left_jacobian(rotation_vector: ArrayLike) -> Array:
    """J with Exp(v + δ) ≈ Exp(J δ) Exp(v); (…, 3) -> (…, 3, 3) (Solà et al., eq. 145)."""
    v = np.asarray(rotation_vector, dtype=float)
    squared = np.sum(v * v, axis=-1)[..., None, None]
    small = squared < _SMALL_SQUARED
    angle = np.sqrt(np.where(small, 1.0, squared))
    first = np.where(small, 0.5 - squared / 24, (1 - np.cos(angle)) / angle**2)
    second = np.where(small, 1 / 6 - squared / 120, (angle - np.sin(angle)) / angle**3)
    cross = hat(v)
    return np.eye(3) + first * cross + second * (cross @ cross)


def from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotation matrix of a quaternion x, y, z, w of any length but 0; (…, 4) -> (…, 3, 3)."""
    q = np.asarray(quaternion, dtype=float)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    cross = hat(q[..., :3])
    return np.eye(3) + 2 * q[..., 3][..., None, None] * cross + 2 * (cross @ cross)


def of_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """`from_quaternion` of one by plain numbers, which every message needs: a tenth of the time."""
    length = math.sqrt(x * x + y * y + z * z + w * w)  # as numpy adds them, to the last bit
    return np.array(_elements(x / length, y / length, z / length, w / length)).reshape(3, 3)


def of_quaternions(quaternions: Array) -> Array:
    """`of_quaternion` of each of (n, 4), to the last bit; (n, 3, 3)."""
    x, y, z, w = np.ascontiguousarray(quaternions.T)
    length = np.sqrt(x * x + y * y + z * z + w * w)
    elements = _elements(x / length, y / length, z / length, w / length)
    return np.stack(elements, axis=-1).reshape(-1, 3, 3)


def _elements(x: _Number, y: _Number, z: _Number, w: _Number) -> tuple[_Number, ...]:
    """The rotation matrix of a unit quaternion, row by row."""
    return (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def to_quaternion(matrix: ArrayLike) -> Array:
    """Unit quaternion x, y, z, w with w ≥ 0; (…, 3, 3) -> (…, 4), near π too."""
    m = np.asarray(matrix, dtype=float)
    if m.ndim == 2:
        return _one_quaternion(m)
    diagonal = np.diagonal(m, axis1=-2, axis2=-1)
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    if np.all(trace[..., None] > diagonal):
        return _quaternions_of_small(m, trace)
    # Row i holds 4·q_i·q; the row of the largest element is the accurate one (Shepperd's method).
    outer = np.empty((*m.shape[:-2], 4, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[..., i, i] = 1 + 2 * m[..., i, i] - trace
        outer[..., i, j] = outer[..., j, i] = m[..., i, j] + m[..., j, i]
        outer[..., i, 3] = outer[..., 3, i] = m[..., k, j] - m[..., j, k]
    outer[..., 3, 3] = 1 + trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    row = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.where(row[..., 3:] < 0, -row, row)


def _quaternions_of_small(matrix: Array, trace: Array) -> Array:
    """`to_quaternion` of matrices all of which turn by less than about 90°: a third of the time."""
    row = np.empty((*trace.shape, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        row[..., i] = matrix[..., k, j] - matrix[..., j, k]
    row[..., 3] = 1 + trace
    return row / np.linalg.norm(row, axis=-1, keepdims=True)


def _one_quaternion(matrix: Array) -> Array:
    """`to_quaternion` of a single matrix, which every message needs: a fifth of the time."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix.tolist()
    squares = (1 + xx - yy - zz, 1 + yy - xx - zz, 1 + zz - xx - yy, 1 + xx + yy + zz)
    largest = max(squares)
    if largest == squares[0]:
        row = (largest, xy + yx, xz + zx, zy - yz)
    elif largest == squares[1]:
        row = (xy + yx, largest, yz + zy, xz - zx)
    elif largest == squares[2]:
        row = (xz + zx, yz + zy, largest, yx - xy)
    else:
        row = (zy - yz, xz - zx, yx - xy, largest)
    length = -math.hypot(*row) if row[3] < 0 else math.hypot(*row)
    return np.array(row) / length


def about_z(heading_rad: ArrayLike) -> Array:
    """Rotation about z; (…) -> (…, 3, 3)."""
    heading = np.asarray(heading_rad, dtype=float)
    matrix = np.zeros((*heading.shape, 3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = np.cos(heading)
    matrix[..., 1, 0] = np.sin(heading)
    matrix[..., 0, 1] = -matrix[..., 1, 0]
    matrix[..., 2, 2] = 1.0
    return matrix


def wrap(angle_rad: ArrayLike) -> Array:
    """The same angle in [-π, π)."""
    return (np.asarray(angle_rad, dtype=float) + np.pi) % (2 * np.pi) - np.pi
