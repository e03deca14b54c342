"""What a picture shows of a robot: the corners of its faces, and how they are read.

Where a picture cannot tell which face a view shows, or which way up (contract, section 2, «half
turn»), the view has several readings; the chosen `Reading` is a hypothesis and may change.
"""

from collections.abc import Sequence
from enum import Enum
from functools import cache

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.base.clock import to_ns, to_seconds
from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.config import CameraConfig
from trigpoint.site.target import Face, Target

from .odometry import OdometryTrack
from .rolling_shutter import Sweep, sweep_of

# Lower bound of a corner's sigma, pixels (rounded to float32, like any sighting's). Sharp pictures
# give corners to 0.005 px, but the errors of one view's corners are correlated: no lens model and
# no print is accurate to that (decisions/0661).
LEAST_SIGMA_PX = float(np.float32(0.02))


class Verdict(Enum):
    """What the estimator decided about an observation."""

    PENDING = "its camera is not located yet, or it is not clear which face it shows"
    ACCEPTED = "used"
    REJECTED = "contradicts the rest"


class Reading(Struct, frozen=True):
    """Which face a view shows (index into the target's faces), and whether with the half turn."""

    face: int
    is_turned: bool = False


class View(Struct, frozen=True, eq=False):
    """One face in one picture: corner ids (n,), pixels (n, 2), and the sigma of a coordinate, lens
    and print included.

    `readings`: every way in which the view can be read; `sweep`: the exposure by a rolling shutter.
    """

    corners: np.ndarray
    pixels: Array
    sigma: float
    readings: tuple[Reading, ...]
    sweep: Sweep | None = None


class Observation(Struct, frozen=True):
    """One robot in one picture. `stamp_ns`: when the middle of its corners was exposed, by the
    camera's clock. `chosen`: a reading for each view, or None while that is ambiguous; `is_repeat`:
    it adds no information on the map to the others of the same standstill.

    `outliers`: for each view, (n,) bool, the corners that contradict the rest.
    """

    camera: str
    robot: str
    stamp_ns: int
    views: tuple[View, ...]
    chosen: tuple[Reading, ...] | None
    verdict: Verdict = Verdict.PENDING
    outliers: tuple[np.ndarray, ...] = ()
    is_repeat: bool = False

    def read_as(self, chosen: tuple[Reading, ...]) -> "Observation":
        """The same observation with other readings and no outliers."""
        return replace(self, chosen=chosen, outliers=())

    def judged(self, verdict: Verdict) -> "Observation":
        return replace(self, verdict=verdict)

    def with_outliers(self, outliers: tuple[np.ndarray, ...]) -> "Observation":
        return replace(self, outliers=outliers)

    def marked(self, wild: np.ndarray) -> "Observation":
        """With the outliers flagged (n,) among all corners, concatenated; unchanged without any."""
        if not np.any(wild):
            return self
        return self.with_outliers(tuple(wild[part] for part in self.parts))

    @property
    def is_swept(self) -> bool:
        """Whether its camera has a rolling shutter."""
        return any(view.sweep is not None for view in self.views)

    def moving(self, twist: Array) -> "Observation":
        """The same observation of a robot that moves with a twist (6,)."""
        views = (
            replace(view, sweep=view.sweep.moving(twist)) if view.sweep is not None else view
            for view in self.views
        )
        return replace(self, views=tuple(views))

    def scattering(self, factor: float) -> "Observation":
        """The same observation with the sigma of its corners multiplied by a factor."""
        if factor == 1.0:
            return self
        views = (replace(v, sigma=max(v.sigma * factor, LEAST_SIGMA_PX)) for v in self.views)
        return replace(self, views=tuple(views))

    @property
    def used_views(self) -> int:
        """How many of its views are used."""
        if self.verdict is not Verdict.ACCEPTED:
            return 0
        return len(self.views) - sum(bool(np.all(wild)) for wild in self.outliers)

    @property
    def corner_count(self) -> int:
        return sum(len(view.corners) for view in self.views)

    @property
    def parts(self) -> list[slice]:
        """The slice of each view's corners in the concatenation of all of them."""
        ends = np.cumsum([len(view.corners) for view in self.views]).tolist()
        return [slice(*part) for part in zip([0, *ends[:-1]], ends, strict=True)]

    @property
    def sigmas(self) -> Array:
        """The sigmas of all corners, concatenated, (n,)."""
        return np.concatenate([np.full(len(view.corners), view.sigma) for view in self.views])

    @property
    def wild(self) -> tuple[np.ndarray, ...]:
        """`outliers`, with flags that are all False where there are none."""
        return self.outliers or tuple(np.zeros(len(view.corners), bool) for view in self.views)


class Points(Struct, frozen=True):
    """An observation's corners, concatenated: (n, 3) in their face's frame, corrected for a rolling
    shutter, face index (n,), pixels (n, 2), and 1/sigma (n,), 0 for outliers."""

    face_points: Array
    faces: np.ndarray
    pixels: Array
    weights: Array

    def in_base(self, base_from_face: Pose) -> Array:
        """The corners in the robot's base frame, (n, 3); `base_from_face`: all faces, stacked."""
        faces = base_from_face[self.faces]
        return (faces.rotation @ self.face_points[..., None])[..., 0] + faces.translation


def view_of(target: Target, sighting: FaceSighting, camera: CameraConfig) -> View | None:
    """The view of a sighting, with a sigma of at least LEAST_SIGMA_PX; None where it does not fit
    the target."""
    if sighting.face >= 0:
        indices = [i for i, face in enumerate(target.faces) if face.id == sighting.face]
    else:
        indices = list(range(len(target.faces)))
    highest = int(sighting.corners.max())
    indices = [i for i in indices if highest < target.faces[i].corner_count]
    if sighting.face < 0:
        indices = [i for i in indices if len(target.look_alikes(target.faces[i].appearance)) > 1]
    readings = tuple(
        Reading(i, turned)
        for i in indices
        for turned in ((False, True) if target.faces[i].reads_from_both_ends else (False,))
    )
    if not readings:
        return None
    pixels = np.asarray(sighting.pixels, dtype=float)
    sweep = sweep_of(camera, pixels)
    sigma = max(float(sighting.sigma), LEAST_SIGMA_PX)
    return View(sighting.corners.astype(int), pixels, sigma, readings, sweep)


def observation_of(camera: str, robot: str, stamp_ns: int, views: tuple[View, ...]) -> Observation:
    """A new observation; its reading is chosen where there is only one.

    `stamp_ns`: the picture's stamp, to which the views' exposure times refer. With a rolling
    shutter the observation's own moment is when the middle of its corners was exposed.
    """
    is_plain = all(len(view.readings) == 1 for view in views)
    chosen = tuple(view.readings[0] for view in views) if is_plain else None
    sweep = joined(views)
    if sweep is not None:
        later_ns = to_ns(float(np.mean(sweep.after_s)))
        stamp_ns += later_ns
        views = tuple(
            replace(view, sweep=view.sweep.later(to_seconds(later_ns))) if view.sweep else view
            for view in views
        )
    return Observation(camera, robot, stamp_ns, views, chosen)


def moving(
    observations: list[Observation], track: OdometryTrack, times_ns: np.ndarray, scales: Array
) -> list[Observation]:
    """Observations of a robot, each with the robot's twist by odometry at the true time (n,) at
    which it was seen; those without a rolling shutter are unchanged. `scales`: the odometry's scale
    errors, (2,)."""
    if not any(observation.is_swept for observation in observations):
        return observations
    _, twists = track.carried(times_ns, np.zeros(len(times_ns)), scales)
    return [
        observation.moving(twist) if observation.is_swept else observation
        for observation, twist in zip(observations, twists, strict=True)
    ]


def face_points(face: Face, corners: np.ndarray, *, is_turned: bool) -> Array:
    """Positions (n, 3) of corner ids in the face's frame, read from the other end if turned."""
    ids = face.corner_count - 1 - corners if is_turned else corners
    return face.corners[ids]


def swept(points: Array, view: View, face: Face) -> Array:
    """A view's corners (n, 3) in their face's frame, each when its own row is exposed."""
    if view.sweep is None:
        return points
    base_from_face = face.base_from_face
    return points + view.sweep.shift(base_from_face @ points) @ base_from_face.rotation


def corners_in_base(
    view: View, reading: Reading, target: Target, base_from_face: Pose | None = None
) -> Array:
    """A view's corners (n, 3) in the robot's base frame by a reading, each when its own row is
    exposed; `base_from_face`: all faces, where they are not as the target says."""
    face = target.faces[reading.face]
    poses = base_from_faces(target) if base_from_face is None else base_from_face
    points = poses[reading.face] @ face_points(face, view.corners, is_turned=reading.is_turned)
    return points if view.sweep is None else points + view.sweep.shift(points)


def joined(views: Sequence[View]) -> Sweep | None:
    """The sweeps of many views, concatenated over their corners; None where no view has one."""
    if all(view.sweep is None for view in views):
        return None
    after_s, twists = [], []
    for view in views:
        sweep = view.sweep or Sweep(np.zeros(len(view.corners)), np.zeros(6))
        after_s.append(sweep.after_s)
        twists.append(np.broadcast_to(sweep.twist, (len(sweep.after_s), 6)))
    return Sweep(np.concatenate(after_s), np.concatenate(twists))


def points_of(observation: Observation, target: Target) -> Points:
    """The observation's corners according to its chosen readings."""
    assert observation.chosen is not None
    parts = []
    for index, (view, reading) in enumerate(
        zip(observation.views, observation.chosen, strict=True)
    ):
        face = target.faces[reading.face]
        weights = np.full(len(view.corners), 1 / view.sigma)
        if observation.outliers:
            weights[observation.outliers[index]] = 0.0
        points = swept(face_points(face, view.corners, is_turned=reading.is_turned), view, face)
        parts.append((points, np.full(len(view.corners), reading.face), view.pixels, weights))
    return Points(*(np.concatenate(part) for part in zip(*parts, strict=True)))


@cache
def base_from_faces(target: Target) -> Pose:
    """All faces' poses on the robot, stacked in the target's order; read-only."""
    stacked = Pose.stack([face.base_from_face for face in target.faces])
    stacked.rotation.flags.writeable = stacked.translation.flags.writeable = False
    return stacked
