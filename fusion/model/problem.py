"""The smoother's least-squares problem: its data, its unknowns, and their order.

Unknowns are the robots' poses at their sightings («nodes», a chain per robot, linked by odometry)
and the dense part: cameras, and where they have a prior sigma lenses, time offsets, odometry
scales and the faces' poses. A camera sees one robot at a time, so the normal equations
(`native/src/fusion/elimination.hpp`) are

    [A  B ] [nodes]     A: block-tridiagonal, one block row a node
    [Bᵀ C ] [dense]     C: small and dense

Every pose is disturbed by the contract's convention: t' = t + δt, R' = Exp(δθ) R in the parent's
axes; a planar robot by x, y and heading alone. The last node of each robot is in the dense part, so
that the Schur complement after the chains are eliminated is what a filter would know.
"""

from typing import Self

import numpy as np
from msgspec import Struct, field

from trigpoint.base.clock import NANOSECONDS
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array

from .known_cameras import KnownCameras
from .motion import Motion, both, moved
from .odometry import PLANAR, SPATIAL, OdometryTrack


class CameraState(Struct, frozen=True):
    """The estimate of one camera, with its clock's offset at the data set's epoch and its drift
    (s/s) from there."""

    map_from_camera: Pose
    lens: CameraModel
    time_offset_s: float = 0.0
    time_drift: float = 0.0

    @property
    def clock(self) -> tuple[float, float]:
        """The clock's offset and drift."""
        return self.time_offset_s, self.time_drift

    def offset_s(self, since_epoch_s: Array) -> Array:
        """The time offset at stamps, seconds."""
        return self.time_offset_s + self.time_drift * since_epoch_s


class RobotState(Struct, frozen=True):
    """The estimate of one robot: its nodes (n) in the map, its scales (2,), its faces."""

    map_from_base: Pose
    scales: Array
    base_from_face: Pose


class State(Struct, frozen=True):
    """All unknowns with their current values."""

    cameras: dict[str, CameraState]
    robots: dict[str, RobotState]


class Chain(Struct, frozen=True):
    """One robot's nodes and the motion between them.

    `is_anchored`: node 0 is known exactly (the map's origin). `scales`: those at which `motion` was
    computed; `track`: the odometry behind it.
    """

    robot: str
    stamps_ns: np.ndarray
    motion: Motion | None
    track: OdometryTrack
    scales: Array
    planar: bool
    is_anchored: bool

    @classmethod
    def unlinked(
        cls, robot: str, stamps_ns: np.ndarray, track: OdometryTrack, scales: Array | None = None
    ) -> Self:
        """Nodes without any motion between them."""
        here = scales if scales is not None else np.zeros(2)
        return cls(robot, stamps_ns, None, track, here, track.planar, is_anchored=False)

    @property
    def tangent(self) -> list[int]:
        """Indices of the free components of a node's disturbance (6,)."""
        return PLANAR if self.planar else SPATIAL

    def __len__(self) -> int:
        return len(self.stamps_ns)


def true_times_ns(stamps_ns: np.ndarray | int, offset_s: Array) -> np.ndarray:
    """The true times (…) of stamps (…): true time = stamp - time offset."""
    return stamps_ns - np.round(offset_s * NANOSECONDS).astype(np.int64)


class Carried(Struct, frozen=True):
    """How a robot moves from its nodes to the moments at which a camera sees it, as a function of
    the camera's time offset.

    `way` (n): the motion from each node to where the sighting is with the assumed offset,
    `offset_s` (n,); `twists` (n, 6): about then, in the base frame. So it is differentiable also
    where the odometry's twist changes at a message, just when a camera that is triggered with the
    odometry sees the robot; a problem is reassembled where its offsets have changed.
    """

    way: Pose
    twists: Array
    offset_s: Array

    @classmethod
    def of(cls, chain: Chain, nodes: np.ndarray, stamps_ns: np.ndarray, offset_s: Array) -> Self:
        """From a chain's nodes (n,) to sightings with stamps (n,) and assumed offsets (n,)."""
        start_ns, times_ns = chain.stamps_ns[nodes], true_times_ns(stamps_ns, offset_s)
        way, _ = chain.track.carried(start_ns, (times_ns - start_ns) / NANOSECONDS, chain.scales)
        return cls(way, chain.track.twists_about(times_ns) * both(1 + chain.scales), offset_s)

    def at(self, offset_s: Array) -> Pose:
        """The motions (n) from nodes to sightings, with time offsets (n,)."""
        return self.way @ moved(self.twists * (self.offset_s - offset_s)[:, None])


class Batch(Struct, frozen=True):
    """All used observations of one robot by one camera, padded to one size K.

    `nodes` (n,), `face_points` (n, K, 3), `faces` (n, K), `pixels` (n, K, 2), `weights` (n, K):
    1/sigma times the root of the share, 0 for padding and outliers; `shares` (n,): the weight of
    each observation; `sources` (n,): index into the data set; `since_epoch_s` (n,): the stamps,
    since the data set's epoch; `carried`: from the nodes to the sightings, where the camera's time
    offset is estimated; `jitter` (n, 2, 6): variances of the deviation of the target's pose in each
    picture from its node (a floor that tilts, a mast that sways), a disturbance in the map's axes
    that all its corners share, as `Jitter.in_pictures`; None: no deviation.
    """

    camera: str
    robot: str
    nodes: np.ndarray
    face_points: Array
    faces: np.ndarray
    pixels: Array
    weights: Array
    shares: Array
    sources: np.ndarray
    since_epoch_s: Array
    carried: Carried | None = None
    jitter: Array | None = None


class Priors(Struct, frozen=True):
    """Gaussian priors of the dense unknowns.

    `lens`: camera -> (parameters, sigmas); `time_offset`: camera -> (2,) sigmas of offset and
    drift; `scales`: robot -> (2,) sigmas; `faces`: robot -> (base_from_face, translation sigma,
    rotation sigma); `known`: what is known from before, each camera by the name of its place;
    what is known of a lens, a clock, scales or faces has infinite sigmas among the others;
    `owners`: camera -> the one whose lens and clock it shares (the first of a camera's places).
    """

    lens: dict[str, tuple[Array, Array]]
    time_offset: dict[str, Array]
    scales: dict[str, Array]
    faces: dict[str, tuple[Pose, float, float]]
    known: KnownCameras = field(default_factory=KnownCameras.none)
    owners: dict[str, str] = field(default_factory=dict)

    @classmethod
    def none(cls) -> Self:
        return cls({}, {}, {}, {})


class Layout(Struct, frozen=True):
    """Columns (q,) of each unknown of the dense part by name; `size`: how many there are in all."""

    pose: dict[str, np.ndarray]
    lens: dict[str, np.ndarray]
    time_offset: dict[str, np.ndarray]
    scales: dict[str, np.ndarray]
    faces: dict[str, np.ndarray]
    last: dict[str, np.ndarray]
    size: int

    def scales_of(self, robot: str) -> np.ndarray:
        """The columns (2,) of a robot's scales; (0,) where they are not estimated."""
        return self.scales.get(robot, np.arange(0))


class Problem(Struct, frozen=True):
    """The data of one solution."""

    chains: dict[str, Chain]
    batches: tuple[Batch, ...]
    priors: Priors
    layout: Layout


def layout_of(cameras: list[str], chains: dict[str, Chain], priors: Priors, state: State) -> Layout:
    """Give every dense unknown its columns."""
    size = 0

    def take(count: int) -> np.ndarray:
        nonlocal size
        size += count
        return np.arange(size - count, size)

    pose = {name: take(6) for name in cameras}
    lens = {
        name: take(len(state.cameras[name].lens.parameters))
        for name in cameras
        if name in priors.lens
    }
    lens |= {n: lens[o] for n, o in priors.owners.items() if o in lens}
    time_offset = {name: take(2) for name in cameras if name in priors.time_offset}
    time_offset |= {n: time_offset[o] for n, o in priors.owners.items() if o in time_offset}
    scales = {name: take(2) for name in chains if name in priors.scales}
    faces = {name: take(6 * len(priors.faces[name][0])) for name in chains if name in priors.faces}
    last = {name: take(len(chain.tangent)) for name, chain in chains.items()}
    return Layout(pose, lens, time_offset, scales, faces, last, size)
