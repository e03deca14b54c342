"""What a network is worth, held against the truth of a drawn session.

Measures are joint over all located cameras: e stacks their 6n errors by the contract's convention.
"""

from collections.abc import Mapping, Set

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.map.network import CameraRecord, Network, PoseRecord
from trigpoint.tools.networks.cramer_rao import Bound
from trigpoint.tools.networks.truth import CameraError, TruthFile, network_error

from .result import Camera, Result, Verdict

# An error of so many sigmas of the bound (the root of eᵀP⁻¹e/6 of one camera) is no noise: another
# face, another way up, or the plane's other solution.
GROSS = 8.0
# A camera whose position the bound puts within this, metres, is decided by the data.
DECIDED_M = 0.25
# Without a bound: a position that is further off than so many of its own sigmas; or than so many
# metres and a smaller number of sigmas.
WRONG_SIGMAS = 8.0
WRONG_M, WRONG_M_SIGMAS = 0.4, 5.0


class Truth(Struct, frozen=True, eq=False):
    """`places`: map_from_camera of each camera where it hung at last. Of compositions: by how many
    `pictures` that shows. Of situations: the `bound`, and the cameras whose place the data leave
    open."""

    places: dict[str, Pose]
    pictures: Mapping[str, int] = field(default_factory=dict)
    bound: Bound | None = None
    left_open: Set[str] = frozenset()

    @property
    def seen(self) -> TruthFile:
        """Of the cameras that the bound knows, or of all."""
        names = self.places if self.bound is None else self.bound.cameras
        return TruthFile({n: PoseRecord.of(p) for n, p in self.places.items() if n in names})


def judged(blank: Result, truth: Truth, network: Network, covariance: Array) -> Result:
    """The result with what the network comes to; `covariance`: joint, of its located cameras."""
    error = network_error(network, covariance, truth.seen)
    cameras = [
        _camera(truth, name, network.cameras.get(name), error.cameras.get(name))
        for name in truth.places
    ]
    rejected = sum(camera.rejected for camera in network.cameras.values())
    result = replace(blank, cameras=cameras, honesty=error.nees, rejected=rejected)
    if truth.bound is None:
        is_wrong = bool(result.those(Verdict.WRONG))
        return replace(result, honesty=None if is_wrong else error.nees)
    located = [name for name in network.located if name in error.cameras]
    least = truth.bound.of(located)
    off = [_pose(network.cameras[name]).difference(truth.places[name]) for name in located]
    return replace(
        result,
        efficiency=_normalised(np.array(off), least.covariance) if located else None,
        distance=error.distance,
        distance_bound=None if error.distance is None else least.mean_distance_error,
    )


def unlocated(blank: Result, truth: Truth) -> Result:
    """The result without a network."""
    return replace(blank, cameras=[_camera(truth, name, None, None) for name in truth.places])


def _camera(
    truth: Truth, name: str, said: CameraRecord | None, error: CameraError | None
) -> Camera:
    """`error`: of a camera that is located and was seen."""
    camera = Camera(
        name,
        _verdict(truth, name, said, error),
        is_moved=said is not None and bool(said.earlier),
        pictures=truth.pictures.get(name, 0),
    )
    if said is None or error is None:
        return replace(camera, among=None if said is None else _among(said, truth.places[name]))
    return replace(camera, is_confirmed=said.confirmed, error_m=error.position, sigmas=error.sigmas)


def _verdict(
    truth: Truth, name: str, said: CameraRecord | None, error: CameraError | None
) -> Verdict:
    if said is not None and said.map_from_camera is not None:
        if error is not None and _is_wrong(truth, name, said, error):
            return Verdict.WRONG
        is_sound = error is not None and name not in truth.left_open
        return Verdict.RIGHT if is_sound else Verdict.MADE_UP
    if name in truth.left_open:
        return Verdict.LEFT_OPEN
    return Verdict.MISSED if _is_decided(truth.bound, name) else Verdict.UNKNOWN


def _is_wrong(truth: Truth, name: str, said: CameraRecord, error: CameraError) -> bool:
    if truth.bound is not None:
        off = _pose(said).difference(truth.places[name])
        return bool(np.sqrt(_normalised(off, truth.bound.of([name]).covariance)) > GROSS)
    is_far = error.position > WRONG_M and error.sigmas > WRONG_M_SIGMAS
    return is_far or error.sigmas > WRONG_SIGMAS


def _is_decided(bound: Bound | None, name: str) -> bool:
    if bound is None or name not in bound.cameras:
        return False
    return bool(np.sqrt(np.trace(bound.of([name]).covariance[:3, :3])) < DECIDED_M)


def _pose(said: CameraRecord) -> Pose:
    assert said.map_from_camera is not None  # it is located
    return said.map_from_camera.pose


def _normalised(error: Array, covariance: Array) -> float:
    """eᵀP⁻¹e/6n, after scaling P's diagonal to 1: metres and radians differ in size."""
    scale = 1 / np.sqrt(np.diagonal(covariance))
    e = error.reshape(-1) * scale
    return float(e @ np.linalg.solve(covariance * scale[:, None] * scale, e) / len(e))


def _among(said: CameraRecord, place: Pose) -> bool | None:
    """Whether the true place is one of the alternatives; None where there are none."""
    if not said.alternatives:
        return None
    return any(
        _sigmas(one.map_from_camera.pose.difference(place)[:3], np.array(one.covariance))
        < WRONG_SIGMAS
        for one in said.alternatives
    )


def _sigmas(error: Array, covariance: Array) -> float:
    """Of a position's error (3,) by its pose's covariance."""
    position = covariance.reshape(6, 6)[:3, :3]
    return float(np.sqrt(error @ np.linalg.pinv(position) @ error))
