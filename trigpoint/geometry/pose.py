"""Rigid transforms, named `a_from_b`: they take coordinates in b to coordinates in a."""

from collections.abc import Iterable
from typing import Self, overload

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from trigpoint.geometry import rotation as so3

from .rotation import Array


class Pose(Struct, frozen=True, eq=False):
    """One rigid transform, or many: `rotation` (…, 3, 3), `translation` (…, 3), metres."""

    rotation: Array
    translation: Array

    @classmethod
    def identity(cls) -> Self:
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(cls, translation: ArrayLike, quaternion: ArrayLike) -> Self:
        """From a translation and a quaternion x, y, z, w."""
        return cls(so3.from_quaternion(quaternion), np.array(translation, dtype=float))

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        """From x, y, z and a rotation vector; (…, 6)."""
        v = np.asarray(vector, dtype=float)
        return cls(so3.exp(v[..., 3:]), v[..., :3].copy())

    @classmethod
    def planar(cls, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike) -> Self:
        """A pose in the plane z = 0."""
        x, y, heading = np.broadcast_arrays(*(np.asarray(v, float) for v in (x, y, heading_rad)))
        return cls(so3.about_z(heading), np.stack([x, y, np.zeros_like(x)], axis=-1))

    @classmethod
    def stack(cls, poses: "list[Pose]") -> Self:
        """Many poses as one with a leading dimension."""
        return cls(
            np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3),
            np.array([pose.translation for pose in poses]).reshape(-1, 3),
        )

    @classmethod
    def joined(cls, parts: "Iterable[Pose]") -> Self:
        """Poses (n), (m) and so on, one after the other; of no parts none."""
        every = [cls.stack([]), *parts]
        return cls(
            np.concatenate([part.rotation for part in every]),
            np.concatenate([part.translation for part in every]),
        )

    @classmethod
    def from_rows(cls, rows: Array) -> Self:
        """From `rows` (…, 12), as the compiled core writes them."""
        rotation = np.ascontiguousarray(rows[..., :9]).reshape(*rows.shape[:-1], 3, 3)
        return cls(rotation, np.ascontiguousarray(rows[..., 9:]))

    def rows(self) -> Array:
        """As the compiled core takes poses: the rotation row by row, then the translation;
        (n, 12) in one piece, one pose as a row of its own."""
        rotation, translation = self.rotation.reshape(-1, 9), self.translation.reshape(-1, 3)
        return np.ascontiguousarray(np.concatenate([rotation, translation], axis=1))

    def repeated(self, count: int) -> "Pose":
        """This pose `count` times; read-only."""
        return Pose(
            np.broadcast_to(self.rotation, (count, 3, 3)),
            np.broadcast_to(self.translation, (count, 3)),
        )

    @property
    def quaternion(self) -> Array:
        """Unit quaternion x, y, z, w with w ≥ 0; (…, 4)."""
        return so3.to_quaternion(self.rotation)

    @property
    def heading(self) -> Array:
        """Direction of the x axis in the parent's xy plane, radians."""
        return np.arctan2(self.rotation[..., 1, 0], self.rotation[..., 0, 0])

    def __len__(self) -> int:
        return len(self.translation) if self.translation.ndim > 1 else 1

    def __getitem__(self, index: int | slice | np.ndarray) -> "Pose":
        """One of many, or some of them, by the leading dimension."""
        return Pose(self.rotation[index], self.translation[index])

    @overload
    def __matmul__(self, other: "Pose") -> "Pose": ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: "Pose | Array") -> "Pose | Array":
        """a_from_b @ b_from_c, or a_from_b @ points in b; one point (3,) or points (…, n, 3)."""
        if isinstance(other, Pose):
            moved = (self.rotation @ other.translation[..., None])[..., 0]
            return Pose(self.rotation @ other.rotation, moved + self.translation)
        if other.ndim == 1:
            return self.rotation @ other + self.translation
        return other @ np.swapaxes(self.rotation, -1, -2) + self.translation[..., None, :]

    def inverse(self) -> "Pose":
        """b_from_a."""
        transposed = np.swapaxes(self.rotation, -1, -2)
        return Pose(transposed, -(transposed @ self.translation[..., None])[..., 0])

    def disturbed(self, disturbance: ArrayLike) -> "Pose":
        """The contract's disturbance (…, 6): t' = t + δt, R' = Exp(δθ) R, in the parent's axes."""
        d = np.asarray(disturbance, dtype=float)
        return Pose(so3.exp(d[..., 3:]) @ self.rotation, self.translation + d[..., :3])

    def moved(self, disturbance: ArrayLike) -> "Pose":
        """Equal to `disturbed` to first order, but a disturbance that many poses share as one
        rigid motion moves them as one however large it is: the left twist of SE(3) with
        ω = δθ, v = δt - δθ × t (Solà et al., eq. 172)."""
        d = np.asarray(disturbance, dtype=float)
        turn = d[..., 3:]
        linear = d[..., :3] - np.cross(turn, self.translation)
        rotation = so3.exp(turn)
        translation = rotation @ self.translation[..., None]
        translation = translation + so3.left_jacobian(turn) @ linear[..., None]
        return Pose(rotation @ self.rotation, translation[..., 0])

    def difference(self, other: "Pose") -> Array:
        """The disturbance d (…, 6) with `other.disturbed(d) == self`."""
        turn = so3.log(self.rotation @ np.swapaxes(other.rotation, -1, -2))
        return np.concatenate([self.translation - other.translation, turn], axis=-1)


def rows_of(poses: Iterable[Pose]) -> Array:
    """The rows (n, 12) of poses one after the other, each of them one or many."""
    rows = [pose.rows() for pose in poses]
    return rows[0] if len(rows) == 1 else np.concatenate([np.empty((0, 12)), *rows])


def angle_between(first: Pose, second: Pose) -> Array:
    """Angle of the rotation between two poses, radians."""
    return np.linalg.norm(so3.log(np.swapaxes(first.rotation, -1, -2) @ second.rotation), axis=-1)
