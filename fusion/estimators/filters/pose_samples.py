"""Samples of one pose, as disturbances from a pose near their mean."""

from collections.abc import Iterable
from functools import cached_property
from typing import Self

import numpy as np

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

# Metres and radians: far below what a map is good for, far above rounding.
_NO_DISTANCE = 1e-10
_MOST_STEPS = 10


class PoseSamples:
    """Samples of a pose; immutable.

    `about`: a pose near their mean and the disturbances (n, 6) from it to the samples, which
    themselves are only computed where they are asked for: most cameras of a filter are moved many
    times, a little each, before they see a robot again.
    """

    def __init__(self, about: tuple[Pose, Array]) -> None:
        self._about = about

    @classmethod
    def of(cls, poses: Pose) -> Self:
        """From the samples themselves, (n)."""
        samples = cls(_centred(poses))
        samples.__dict__.update(poses=poses, _centre=samples._about)
        return samples

    @cached_property
    def poses(self) -> Pose:
        """The samples (n)."""
        about, disturbances = self._about
        return about.repeated(len(disturbances)).disturbed(disturbances)

    @property
    def disturbances(self) -> Array:
        """The samples' disturbances (n, 6) about a pose near the mean."""
        return self._about[1]

    @property
    def mean(self) -> Pose:
        """The pose from which the disturbances to all samples add up to zero."""
        return self._centre[0]

    @property
    def errors(self) -> Array:
        """The disturbances (n, 6) from the mean to the samples."""
        return self._centre[1]

    def disturbed(self, disturbances: Iterable[Array]) -> "PoseSamples":
        """Each sample moved by its own disturbances, (n, 6), one after the other."""
        poses = self.poses
        for disturbance in disturbances:
            poses = poses.disturbed(disturbance)
        return PoseSamples.of(poses)

    def redrawn(self, disturbances: Array) -> "PoseSamples":
        """As many new samples, by their `disturbances` about the same pose."""
        return PoseSamples((self._about[0], disturbances))

    @cached_property
    def _centre(self) -> tuple[Pose, Array]:
        return _centred(self.poses)


def _centred(poses: Pose) -> tuple[Pose, Array]:
    """The mean of poses (n) and their disturbances (n, 6) from it."""
    mean = Pose(_nearest_rotation(poses), poses.translation.mean(axis=0))
    errors = poses.difference(mean)
    for _ in range(_MOST_STEPS):
        left = errors.mean(axis=0)
        if np.abs(left).max() < _NO_DISTANCE:
            break
        mean = mean.disturbed(left)
        errors = poses.difference(mean)
    return mean, errors


def _nearest_rotation(poses: Pose) -> Array:
    """The rotation (3, 3) from which the squared distances to all of them are least (Moakher,
    «Means and averaging in the group of rotations», 2002): the mean up to the third order."""
    left, _, right = np.linalg.svd(poses.rotation.mean(axis=0))
    turned = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    return left * turned @ right
