"""Samples of one pose, as disturbances from a pose near their mean."""

from collections.abc import Iterable
from functools import cached_property
from typing import Self

import numpy as np
from msgspec import Struct

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

# Metres and radians: far below what a map is good for, far above rounding.
_NO_DISTANCE = 1e-10
_MOST_STEPS = 10


class PoseSamples(Struct, frozen=True, dict=True):
    """Samples of a pose: one near their mean, `about`, and the `disturbances` (n, 6) from it to
    them. The samples themselves are computed where they are asked for: most cameras of a filter are
    redrawn many times, a little each, before they see a robot again. `is_centred`: `about` is their
    mean."""

    about: Pose
    disturbances: Array
    is_centred: bool = False

    @classmethod
    def of(cls, poses: Pose) -> Self:
        """From the samples themselves, (n), about their mean: the pose from which the disturbances
        to all of them add up to zero."""
        mean = Pose(_nearest_rotation(poses), poses.translation.mean(axis=0))
        errors = poses.difference(mean)
        for _ in range(_MOST_STEPS):
            left = errors.mean(axis=0)
            if np.abs(left).max() < _NO_DISTANCE:
                break
            mean = mean.disturbed(left)
            errors = poses.difference(mean)
        found = cls(mean, errors, is_centred=True)
        vars(found)["poses"] = poses  # as `poses` would compute them
        return found

    @cached_property
    def poses(self) -> Pose:
        """The samples (n)."""
        return self.about.repeated(len(self.disturbances)).disturbed(self.disturbances)

    @cached_property
    def centred(self) -> Self:
        """The same samples about their mean."""
        return self if self.is_centred else self.of(self.poses)

    @property
    def mean(self) -> Pose:
        return self.centred.about

    def disturbed(self, disturbances: Iterable[Array]) -> Self:
        """Each sample moved by its own disturbances, (n, 6), one after the other."""
        poses = self.poses
        for disturbance in disturbances:
            poses = poses.disturbed(disturbance)
        return self.of(poses)


def _nearest_rotation(poses: Pose) -> Array:
    """The rotation (3, 3) from which the squared distances to all of them are least (Moakher,
    «Means and averaging in the group of rotations», 2002): the mean up to the third order."""
    left, _, right = np.linalg.svd(poses.rotation.mean(axis=0))
    turned = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    return left * turned @ right
