"""Cameras that are known from an earlier network, and how they crept since then.

A mount creeps as heat, load and time bend it: a random walk of the camera about its own place, of
each camera by itself. What is more than that is a move, which the association finds.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.site.config import CameraConfig

_DAY_NS = 86_400 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Creep:
    """How far a camera creeps along and about each axis: sigmas, m and rad per √day."""

    translation: float
    rotation: float

    @classmethod
    def of(cls, camera: CameraConfig) -> "Creep":
        """As the site file states it."""
        return cls(camera.creep_translation, camera.creep_rotation)

    @classmethod
    def of_all(cls, cameras: Mapping[str, CameraConfig]) -> "dict[str, Creep]":
        """Of each of a site's cameras."""
        return {name: cls.of(camera) for name, camera in cameras.items()}

    def covariance(self, nanoseconds: float) -> Array:
        """Covariance (6, 6) of the disturbance by which a pose crept in a time.

        It turns about its own place and is the same along all axes, so that it is the same in the
        camera's frame and in the map's.
        """
        days = max(nanoseconds, 0.0) / _DAY_NS
        return np.diag(np.repeat([self.translation**2, self.rotation**2], 3)) * days


@dataclass(frozen=True, slots=True)
class KnownCameras:
    """Cameras known from an earlier run: poses, and their joint information (6n, 6n) at the time
    `until_ns` (None: not known, so that they are taken not to creep); `creep`: by camera."""

    poses: dict[str, Pose]
    information: Array
    until_ns: int | None = None
    creep: Mapping[str, Creep] = field(default_factory=dict)

    @classmethod
    def none(cls) -> "KnownCameras":
        return cls({}, np.zeros((0, 0)))

    @property
    def covariance(self) -> Array:
        """Joint covariance (6n, 6n)."""
        return np.linalg.inv(self.information)

    def at(self, stamp_ns: int) -> "KnownCameras":
        """The same at a later time, each camera as much less certain as it may have crept."""
        if self.until_ns is None or stamp_ns <= self.until_ns:
            return self
        crept = np.zeros_like(self.information)
        for row, name in enumerate(self.poses):
            if name in self.creep:
                own = slice(6 * row, 6 * row + 6)
                crept[own, own] = self.creep[name].covariance(stamp_ns - self.until_ns)
        if not np.any(crept):
            return replace(self, until_ns=stamp_ns)
        wider = np.linalg.inv(self.covariance + crept)
        return replace(self, information=wider, until_ns=stamp_ns)


def known_cameras(
    network: Network,
    joint: Array,
    names: Iterable[str],
    *,
    creep: Mapping[str, Creep] | None = None,
) -> KnownCameras:
    """The cameras of an earlier network that this site has too.

    `joint`: (6n, 6n) covariance over all of the network's located cameras, in its order; `creep`:
    of this site's cameras, none where it is not given.
    """
    here = set(names)
    kept = [i for i, name in enumerate(network.located) if name in here]
    poses = {}
    for index in kept:
        record = network.cameras[network.located[index]].map_from_camera
        assert record is not None  # located cameras have a pose
        poses[network.located[index]] = record.pose
    if not poses:
        return KnownCameras.none()
    rows = np.concatenate([np.arange(6 * i, 6 * i + 6) for i in kept])
    covariance = joint[np.ix_(rows, rows)]
    # The first network's gauge is exact, so its covariance may be near singular: a floor of
    # 0.1 mm and 0.1 mrad keeps the information finite and is far below any camera's sigma.
    floor = 1e-8 * np.eye(len(covariance))
    information = np.linalg.inv(covariance + floor)
    return KnownCameras(poses, information, network.until_ns, dict(creep or {}))
