"""The ground truth that a simulator writes beside a session, and errors against it."""

from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from trigpoint.base.errors import InputError, read_text
from trigpoint.geometry import Pose
from trigpoint.geometry import rotation as so3
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever
from trigpoint.map.network import Network, PoseRecord

MOST_SIGMAS = 5.0
"""Of three values that are normally distributed, one in 65 000 lies further out than this."""


class TruthFile(msgspec.Struct, frozen=True):
    """truth.json: camera and robot name to pose and trajectory file."""

    cameras: dict[str, PoseRecord]
    robots: dict[str, str] = {}


class CameraError(Struct, frozen=True):
    """A located camera against the truth: metres, radians, and the distance in its own sigmas.

    `sigmas`: root of eᵀP⁻¹e over the position's three coordinates.
    """

    position: float
    rotation: float
    sigmas: float


class NetworkError(Struct, frozen=True):
    """A network against the truth.

    `distance`: mean absolute error of the distances between cameras, metres, None with fewer than
    two; `nees`: eᵀP⁻¹e over all 6n errors and the joint covariance, per degree of freedom, None
    with none.
    Each error is the left twist ξ with estimate = exp(ξ) · truth, in the map's axes about its
    origin, and the contract's covariance is carried over to it: v = δt + t × δθ, ω = δθ, the same
    to first order about the estimate. The gauge is the contract's on both sides, the first
    robot's odometry frame, so what the map is turned by as a whole counts, as every camera's same
    twist. In metres and radians of each camera it would not be the same: turned by φ the camera
    at t moves on an arc, which differs from φ × t by ½φ²|t|, centimetres at some degrees, where
    the cameras' places in each other's view are known to millimetres (Long et al., «The banana
    distribution is Gaussian», 2012).
    """

    cameras: dict[str, CameraError]
    distance: float | None
    nees: float | None


def load_truth(path: Path) -> TruthFile:
    """Read truth.json; raise InputError with one clear line."""
    text = read_text(path, "truth file", InputError)
    try:
        return msgspec.json.decode(text.encode(), type=TruthFile)
    except msgspec.DecodeError as reason:
        raise InputError(f"{path}: no truth file ({reason}); leave it out or mend it") from None


def network_error(network: Network, covariance: Array, truth: TruthFile) -> NetworkError:
    """Errors of the located cameras that the truth knows; `covariance`: joint, (6n, 6n)."""
    names = [name for name in network.located if name in truth.cameras]
    cameras = {}
    for name in names:
        record = network.cameras[name]
        assert record.map_from_camera is not None  # it is located
        error = record.map_from_camera.pose.difference(truth.cameras[name].pose)
        position = record.covariance_matrix[:3, :3]
        cameras[name] = CameraError(
            float(np.linalg.norm(error[:3])),
            float(np.linalg.norm(error[3:])),
            float(np.sqrt(error[:3] @ np.linalg.solve(position, error[:3]))),
        )
    if not names:
        return NetworkError(cameras, None, None)
    rows = np.concatenate([np.arange(6) + 6 * network.located.index(name) for name in names])
    records = [network.cameras[name].map_from_camera for name in names]
    nees = _joint_error(
        [record.pose for record in records if record is not None],
        [truth.cameras[name].pose for name in names],
        covariance[np.ix_(rows, rows)],
    )
    distance = _distance_error(network, truth, names) if len(names) > 1 else None
    return NetworkError(cameras, distance, nees)


def _joint_error(estimated: list[Pose], true: list[Pose], covariance: Array) -> float:
    """eᵀP⁻¹e of the poses of n cameras in the map, per degree of freedom, by their joint covariance
    (6n, 6n). `NetworkError` says what the errors are."""
    pairs = zip(estimated, true, strict=True)
    error = np.concatenate([_twist(pose @ other.inverse()) for pose, other in pairs])
    turned = np.zeros_like(covariance)
    for start, pose in zip(range(0, len(error), 6), estimated, strict=True):
        turned[start : start + 6, start : start + 6] = _about_origin(pose)
    spread = turned @ covariance @ turned.T
    return float(error @ np.linalg.solve(spread, error)) / len(error)


def _twist(motion: Pose) -> Array:
    """The twist (6,) whose exponential a motion is (Barfoot, «State Estimation for Robotics»)."""
    turn = so3.log(motion.rotation)
    return np.concatenate([np.linalg.solve(so3.left_jacobian(turn), motion.translation), turn])


def _about_origin(map_from_camera: Pose) -> Array:
    """(6, 6): a disturbance of a camera as one about the map's origin, δt + [t]× δθ and δθ."""
    return lever(-map_from_camera.translation)


def _distance_error(network: Network, truth: TruthFile, names: list[str]) -> float:
    estimated = _places([network.cameras[name].map_from_camera for name in names])
    true = _places([truth.cameras[name] for name in names])
    first, second = np.triu_indices(len(names), k=1)
    distances = [np.linalg.norm(p[first] - p[second], axis=1) for p in (estimated, true)]
    return float(np.mean(np.abs(distances[0] - distances[1])))


def _places(records: list[PoseRecord | None]) -> Array:
    return np.array([record.translation for record in records if record is not None])
