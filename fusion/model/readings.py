"""Odometry messages of one robot that came one after the other, as arrays."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import Odometry
from trigpoint.geometry import Pose


class Readings(Struct, frozen=True):
    """Odometry messages of one robot that came one after the other: stamps (n,), ns, and poses
    (n)."""

    stamps_ns: np.ndarray
    odom_from_base: Pose

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, rows: slice | np.ndarray) -> "Readings":
        return Readings(self.stamps_ns[rows], self.odom_from_base[rows])

    @property
    def last_ns(self) -> int:
        return self.stamps_ns.item(-1)

    @classmethod
    def of(cls, messages: Sequence[Odometry]) -> Self:
        stamps_ns = np.array([message.stamp_ns for message in messages], dtype=np.int64)
        return cls(stamps_ns, Pose.stack([message.pose for message in messages]))

    @classmethod
    def joined(cls, some: "Sequence[Readings]") -> Self:
        """Some, one after the other."""
        return cls(
            np.concatenate([each.stamps_ns for each in some]),
            Pose.joined(each.odom_from_base for each in some),
        )
