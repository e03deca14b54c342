"""What the map of corrections is worked out from: located cameras, and what robots carry."""

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.observations import LEAST_SIGMA_PX
from trigpoint.fusion.model.odometry import PLANAR, SPATIAL
from trigpoint.fusion.reading.sight import Eye, Faces
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import median
from trigpoint.map.network import CameraRecord, Network, RobotRecord
from trigpoint.site.config import RobotConfig
from trigpoint.site.target import Target

USUAL_SIGMA_PX = 0.15
"""Of a corner where no camera of a network has seen one: the simulated lab's."""


class Carried(Struct, frozen=True, eq=False):
    """What robots carry. `robots`: who; `faces`: of their target, as these were found to be
    mounted; `tangent`: the components of their pose that are free."""

    robots: tuple[str, ...]
    faces: Faces
    tangent: tuple[int, ...]


class KnownNetwork(Struct, frozen=True, eq=False):
    """Located cameras, and the joint covariance (6n, 6n) of their poses."""

    eyes: tuple[Eye, ...]
    covariance: Array

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(eye.name for eye in self.eyes)

    def with_camera(self, eye: Eye, covariance: Array) -> "KnownNetwork":
        """And one more, whose error (6, 6) is independent of the others'."""
        size = len(self.covariance)
        joint = np.zeros((size + 6, size + 6))
        joint[:size, :size], joint[size:, size:] = self.covariance, covariance
        return KnownNetwork((*self.eyes, eye), joint)

    @property
    def usual_covariance(self) -> Array:
        """The covariance (6, 6) of a camera that is known as well as the middle one of these, alike
        in all directions."""
        blocks = np.stack(
            [self.covariance[i : i + 6, i : i + 6] for i in range(0, len(self.covariance), 6)]
        )
        shift = median(np.trace(blocks[:, :3, :3], axis1=1, axis2=2)) / 3
        turn = median(np.trace(blocks[:, 3:, 3:], axis1=1, axis2=2)) / 3
        return np.diag([shift] * 3 + [turn] * 3)

    @property
    def usual_sigma_px(self) -> float:
        """The middle one of the cameras' sigmas of a corner."""
        return median([eye.sigma_px for eye in self.eyes])


def known_network(network: Network, covariance: Array) -> KnownNetwork:
    """The located cameras of a network; `covariance`: joint, in their order.

    A corner's noise is the RMS residual of the camera's own pictures; a camera without any (known
    from an earlier run, and not seen yet) has the others' median.
    """
    records = [network.cameras[name] for name in network.located]
    measured = [r.reprojection_rms for r in records if r.reprojection_rms]
    usual = median(measured) if measured else USUAL_SIGMA_PX
    eyes = (_eye(n, r, usual) for n, r in zip(network.located, records, strict=True))
    return KnownNetwork(tuple(eyes), covariance)


def _eye(name: str, record: CameraRecord, usual_px: float) -> Eye:
    assert record.map_from_camera is not None  # it is located
    assert record.intrinsics is not None
    sigma_px = max(record.reprojection_rms or usual_px, LEAST_SIGMA_PX)
    return Eye(name, record.map_from_camera.pose, record.intrinsics.camera, sigma_px)


def carried_by(
    robots: Mapping[str, RobotConfig], targets: Mapping[str, Target], network: Network
) -> tuple[Carried, ...]:
    """What the robots carry, each with the faces where the network found them; robots that carry
    the same in the same way are together."""
    found: list[Carried] = []
    for name, config in robots.items():
        faces = _faces(targets[name], network.robots.get(name))
        tangent = tuple(PLANAR if config.planar else SPATIAL)
        for index, other in enumerate(found):
            if _is_alike(other, faces, tangent):
                found[index] = Carried((*other.robots, name), faces, tangent)
                break
        else:
            found.append(Carried((name,), faces, tangent))
    return tuple(found)


def _faces(target: Target, record: RobotRecord | None) -> Faces:
    said = {face.id: face for face in record.target.faces} if record is not None else {}
    poses = [
        Pose.from_quaternion(said[face.id].translation, said[face.id].quaternion)
        if face.id in said
        else face.base_from_face
        for face in target.faces
    ]
    return Faces(target, Pose.stack(poses))


def _is_alike(one: Carried, faces: Faces, tangent: Sequence[int]) -> bool:
    mine, other = one.faces.base_from_face, faces.base_from_face
    return (
        one.faces.target.faces == faces.target.faces
        and one.tangent == tuple(tangent)
        and bool(np.allclose(mine.translation, other.translation, atol=1e-4))
        and bool(np.allclose(mine.rotation, other.rotation, atol=1e-4))
    )
