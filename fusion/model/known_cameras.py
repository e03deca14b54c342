"""What is known from before a map's first message: cameras, and how they crept since then; and what
is known along with them, such as lenses, of a past that is not kept any more.

A mount creeps as heat, load and time bend it: a random walk of the camera about its own place, of
each camera by itself. What is more than that is a move, which the association finds.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import Network
from trigpoint.site.config import CameraConfig

_DAY_NS = 86_400 * NANOSECONDS


class Creep(Struct, frozen=True):
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


class KnownCameras(Struct, frozen=True, eq=False, dict=True):
    """Cameras known from before, and the unknowns that go with them: their values, and their joint
    information (n, n) at the time `until_ns` (None: not known, so that cameras are taken not to
    creep).

    The information is that of disturbances of `poses`, by camera, and of `faces` (base_from_face,
    by robot), six of each pose, and then of the `values` by what they are and whose: "lens"
    (parameters) and "clock" (offset and drift) of a camera, "scales" of a robot. `creep`: by
    camera.
    """

    poses: dict[str, Pose]
    information: Array
    until_ns: int | None = None
    creep: Mapping[str, Creep] = field(default_factory=dict)
    faces: dict[str, Pose] = field(default_factory=dict)
    values: dict[tuple[str, str], Array] = field(default_factory=dict)

    @classmethod
    def none(cls) -> "KnownCameras":
        return cls({}, np.zeros((0, 0)))

    @cached_property
    def covariance(self) -> Array:
        """Joint covariance (n, n)."""
        return np.linalg.inv(self.information)

    @property
    def of_poses(self) -> "KnownCameras":
        """The cameras' poses alone."""
        return self.without(lambda kind, _: kind != "pose")

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

    def beside(self, other: "KnownCameras") -> "KnownCameras":
        """With the faces and values that another one has too, independent of these."""
        if not other.faces and not other.values:
            return self
        poses = 6 * len(self.poses) + 6 * sum(len(faces) for faces in self.faces.values())
        faces = 6 * sum(len(each) for each in other.faces.values())
        sizes = poses, len(self.information) - poses, faces, len(other.information) - faces
        order = np.argsort(np.repeat([0, 2, 1, 3], sizes), kind="stable")  # faces before values
        both = block_diagonal(self.information, other.information)
        return replace(
            self,
            information=both[np.ix_(order, order)],
            faces={**self.faces, **other.faces},
            values={**self.values, **other.values},
        )

    def without(self, is_gone: Callable[[str, str], bool]) -> "KnownCameras":
        """The same without some of it, which is taken out of the joint distribution; `is_gone`: by
        what it is ("pose", "faces", or the kind of a value) and whose."""
        parts = [
            *(("pose", name, 6) for name in self.poses),
            *(("faces", robot, 6 * len(faces)) for robot, faces in self.faces.items()),
            *((kind, owner, len(value)) for (kind, owner), value in self.values.items()),
        ]
        is_kept = [not is_gone(kind, owner) for kind, owner, _ in parts]
        if all(is_kept):
            return self
        kept = np.repeat(is_kept, [width for *_, width in parts])
        return replace(
            self,
            poses={n: pose for n, pose in self.poses.items() if not is_gone("pose", n)},
            information=np.linalg.inv(self.covariance[np.ix_(kept, kept)]),
            faces={n: faces for n, faces in self.faces.items() if not is_gone("faces", n)},
            values={key: value for key, value in self.values.items() if not is_gone(*key)},
        )


def block_diagonal(first: Array, second: Array) -> Array:
    """Two square matrices as one, with nothing between them."""
    size = len(first)
    whole = np.zeros((size + len(second),) * 2)
    whole[:size, :size], whole[size:, size:] = first, second
    return whole


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
