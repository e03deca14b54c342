"""What a camera finds of a target at many poses of its robot, and the information in that.

A face is found where it turns its front to the camera, the smallest side of its squares (or tags)
is long enough, and enough of its corners lie in the picture with no other face in between: all of a
checkerboard, six of a marked board. These are the rules by which the simulated lab's detector finds
faces (`tools/simulation`); walls are not known. Which face it is, is taken as known: a robot's
odometry tells that apart. The core looks (`sight.cpp`).
"""

from functools import cached_property, lru_cache

import numpy as np
from msgspec import Struct

from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry.rotation import Array
from trigpoint.native.library import In, Kernel, Out
from trigpoint.site.target import Face, Pattern, Target

from .views import body_tables

FEWEST_CORNERS = 6
"""Of a marked board that is seen in part."""
_SAMPLES = 17
_REAL, _WHOLE = np.float64, np.int64
_SIGHT = Kernel(
    "tp_sight",
    *(In(_REAL, ("p",)), In(_REAL, (4,)), In(_REAL, (4,)), In(_REAL, (3, 3)), In(_REAL, (3,))),
    *(In(_REAL, ("n", 3, 3)), In(_REAL, ("n", 3)), In(_REAL, ("f", 3, 3)), In(_REAL, ("f", 3))),
    *(In(_REAL, ("f", "c", 3)), In(_WHOLE, ("f",)), In(_WHOLE, ("f",)), In(_REAL, ("f", 4))),
    *(In(_REAL, ("f", "s", 3)), In(_WHOLE, ("f",)), In(_REAL, ("f", 4, 3))),
    *(Out(np.bool_, ("n", "f", "c")), Out(_REAL, ("m", 6, 6))),
)


class Rules(Struct, frozen=True):
    """When a face is found: the least cosine of the angle between its normal and the line of sight,
    the shortest side of a square, and how far from the picture's edge a corner is; pixels."""

    least_cosine: float
    least_side_px: float
    margin_px: float


DETECTED = Rules(0.26, 7.0, 5.0)
"""By which the detector finds a face: 75° from the normal."""


class Eye(Struct, frozen=True, eq=False):
    """A located camera; `sigma_px`: of a corner's coordinate in its pictures."""

    name: str
    map_from_camera: Pose
    lens: CameraModel
    sigma_px: float

    def reach_m(self, square_m: float) -> float:
        """From farther away no square of this size is large enough."""
        return _scale_px(self.lens) * square_m / DETECTED.least_side_px

    def may_see(self, faces: "Faces", places: Array) -> np.ndarray:
        """False where a robot at places (n, 2) shows it nothing, whatever its heading; (n,)."""
        height, reach, square = faces.ball
        centres = np.column_stack([places, np.full(len(places), height)])
        offset = (centres - self.map_from_camera.translation) @ self.map_from_camera.rotation
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        off_axis = np.arccos(np.clip(offset[:, 2] / distance, -1, 1))
        within = np.arcsin(np.minimum(reach / distance, 1.0))
        is_near = distance - reach <= self.reach_m(square)
        return is_near & ((distance <= reach) | (off_axis - within < _widest_rad(self.lens)))


class Faces(Struct, frozen=True, eq=False, dict=True):
    """A target's faces (f) at `base_from_face`, as they are found to be mounted."""

    target: Target
    base_from_face: Pose

    @property
    def shape(self) -> tuple[int, int]:
        """How many faces, and the most corners of one."""
        return len(self.target.faces), max(face.corner_count for face in self.target.faces)

    @cached_property
    def ball(self) -> tuple[float, float, float]:
        """Everything that it shows, whatever the heading: the height of the middle, the greatest
        distance from there, and the largest square; metres."""
        faces = self.target.faces
        points = np.concatenate([self.base_from_face[i] @ f.corners for i, f in enumerate(faces)])
        height = float((points[:, 2].min() + points[:, 2].max()) / 2)
        reach = float(np.linalg.norm(points - [0.0, 0.0, height], axis=1).max())
        return height, reach, max(face.square for face in faces)

    @cached_property
    def tables(self) -> tuple[np.ndarray, ...]:
        """As the core takes them, all in the face's own frame: where each face is mounted; its
        corners, how many these are and how many must be seen; the rectangle of its pattern; the
        ends of the sides of the squares (or tags) in its four corners, among which is the smallest
        one in any picture; and its nodes (4, 3), the Gauss quadrature of its corners. Those have
        the corners' moments up to the third, and the information in a corner hardly differs from a
        polynomial of that degree over a board: so four points weigh as much as 12 or 48."""
        faces = self.target.faces
        corners, counts, _, outlines = body_tables(self.target)
        sides, ends = _padded([_sides(face) for face in faces])
        needed = [
            n if face.pattern is Pattern.CHECKERBOARD else min(FEWEST_CORNERS, n)
            for face, n in zip(faces, counts.tolist(), strict=True)
        ]
        signs = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return (
            np.ascontiguousarray(self.base_from_face.rotation),
            np.ascontiguousarray(self.base_from_face.translation),
            *(corners, counts, np.array(needed)),
            *(outlines, sides, ends),
            np.stack([f.corners.mean(axis=0) + signs * f.corners.std(axis=0) for f in faces]),
        )


class PoseInformation(Struct, frozen=True, eq=False):
    """At which poses a camera finds a target, `rows` (k,), and the information (k, 6, 6) of its
    picture on the disturbance of the robot's pose there."""

    rows: np.ndarray
    information: Array


def information_at(eye: Eye, faces: Faces, map_from_base: Pose) -> PoseInformation:
    """What a camera's picture tells of a robot at each of its poses (n)."""
    information = np.zeros((len(map_from_base), 6, 6))
    _look(eye, faces, map_from_base, DETECTED, information)
    rows = np.flatnonzero(information.any(axis=(1, 2)))
    return PoseInformation(rows, information[rows] / eye.sigma_px**2)


def corners_found(eye: Eye, faces: Faces, map_from_base: Pose, rules: Rules) -> np.ndarray:
    """Which corners (n, f, c) of its faces a camera finds at a robot's poses (n); none where too
    few of a face are seen."""
    return _look(eye, faces, map_from_base, rules, np.zeros((0, 6, 6)))


def _look(
    eye: Eye, faces: Faces, map_from_base: Pose, rules: Rules, information: Array
) -> np.ndarray:
    seen = np.empty((len(map_from_base), *faces.shape), dtype=bool)
    bounds = rules.least_cosine, rules.least_side_px, _widest_rad(eye.lens), _scale_px(eye.lens)
    _SIGHT(
        *(eye.lens.parameters, eye.lens.limits(rules.margin_px), np.array(bounds)),
        np.ascontiguousarray(eye.map_from_camera.rotation),
        np.ascontiguousarray(eye.map_from_camera.translation),
        np.ascontiguousarray(map_from_base.rotation),
        np.ascontiguousarray(map_from_base.translation),
        *(*faces.tables, seen, information),
    )
    return seen


@lru_cache
def _widest_rad(lens: CameraModel) -> float:
    """The angle between the optical axis and the picture's farthest edge."""
    right, bottom = lens.width - 0.5, lens.height - 0.5
    ends = [[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]]
    angles = np.arctan(np.linalg.norm(lens.directions(ends), axis=-1))
    # Where the lens cannot be inverted (a fisheye's edge), half of all directions.
    return float(angles.max()) if np.all(np.isfinite(angles)) else np.pi / 2


@lru_cache
def _scale_px(lens: CameraModel) -> float:
    """How large a metre across the line of sight, at a metre's distance, is in the picture at most,
    pixels."""
    u, v = (np.linspace(0, side - 1.0, _SAMPLES) for side in (lens.width, lens.height))
    ways = lens.directions(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    ways = ways[np.all(np.isfinite(ways), axis=1)]
    rays = np.column_stack([ways, np.ones(len(ways))])
    _, by_point = lens.project_by_point(rays / np.linalg.norm(rays, axis=1)[:, None])
    return float(np.linalg.svd(by_point, compute_uv=False).max())


def _padded(parts: list[Array]) -> tuple[Array, np.ndarray]:
    """Points (f, most, 3) of each part, and how many these are."""
    counts = np.array([len(part) for part in parts])
    table = np.zeros((len(parts), counts.max(), 3))
    for row, part in zip(table, parts, strict=True):
        row[: len(part)] = part
    return table, counts


def _sides(face: Face) -> Array:
    """The ends (2 s, 3), one after the other, of the sides of the squares, or tags, at a face's
    outermost corners."""
    corners = face.corners
    across, along = corners[:, 0] - corners[:, 1], corners[:, 0] + corners[:, 1]
    ends = [int(e) for e in (along.argmin(), across.argmax(), along.argmax(), across.argmin())]
    if face.pattern is Pattern.APRILGRID:
        tags = {4 * (end // 4) for end in ends}
        pairs = [(tag + k, tag + (k + 1) % 4) for tag in sorted(tags) for k in range(4)]
        return corners[np.array(pairs)].reshape(-1, 3)
    columns, rows = face.columns - 1, face.rows - 1
    pairs = []
    for end in ends:
        row, column = divmod(end, columns)
        if columns > 1:
            pairs.append((end, end + (1 if column == 0 else -1)))
        if rows > 1:
            pairs.append((end, end + columns * (1 if row == 0 else -1)))
    return corners[np.array(pairs, dtype=int).reshape(-1, 2)].reshape(-1, 3)
