"""Makes networks' cameras, and compares two networks of the same session."""

from typing import Any

import numpy as np

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import CameraRecord, IntrinsicsRecord, Network, PoseRecord


def located(
    pose: Pose, covariance: Array, number: int = 0, *, lens: CameraModel | None = None, **more: Any
) -> CameraRecord:
    """A camera there; `covariance`: its own, or the joint one, in which it has this number; `lens`:
    exactly known."""
    rows = slice(6 * number, 6 * number + 6)
    if lens is not None:
        more |= {"intrinsics": IntrinsicsRecord.of(lens, np.zeros(len(lens.parameters)))}
    numbers = tuple(covariance[rows, rows].reshape(-1).tolist())
    return CameraRecord("located", map_from_camera=PoseRecord.of(pose), covariance=numbers, **more)


def apart_sigmas(mine: CameraRecord, other: CameraRecord) -> Array:
    """By how many of the other's sigmas two located cameras differ, (6,)."""
    assert mine.map_from_camera is not None
    assert other.map_from_camera is not None
    apart = mine.map_from_camera.pose.difference(other.map_from_camera.pose)
    return apart / np.sqrt(np.diagonal(other.covariance_matrix))


def assert_same_place(mine: CameraRecord, other: CameraRecord) -> None:
    """Within a tenth of a sigma: both are at the least cost to a hundredth of one (the final
    tolerance of χ² is 1e-4)."""
    assert mine.status == other.status
    np.testing.assert_allclose(apart_sigmas(mine, other), 0.0, atol=0.1)


def assert_same_places(network: Network, expected: Network) -> None:
    """The same of every camera, and by as many sightings."""
    for name, record in expected.cameras.items():
        assert network.cameras[name].sightings == record.sightings
        assert_same_place(network.cameras[name], record)
