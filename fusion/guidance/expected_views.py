"""What cameras would see of a robot at candidate poses, and the information in that."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.places import are_near
from trigpoint.fusion.model.prediction import batch_jacobian
from trigpoint.fusion.model.problem import (
    Batch,
    CameraState,
    Chain,
    Layout,
    Priors,
    Problem,
    RobotState,
    State,
)
from trigpoint.fusion.model.thinning import thinned
from trigpoint.fusion.solver.snapshot import GuidanceWorld, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern

from .candidates import SEEN_M, Candidates

# A pose is a candidate where some face is wholly and well in a picture, not seen too steeply, and
# its squares are large enough to be found, with some room for what is not exactly as expected.
_MARGIN_PX = 8.0
_STEEPEST_COSINE = 0.35
_LEAST_SQUARE_PX = 8.0
_FEWEST_CORNERS = 6
_MOST_VISITS = 360
_AT_ONCE = 64


class Visits(Struct, frozen=True):
    """What a picture by each of `cameras` would tell at candidates `rows` (m,): information (m, q,
    q) over `columns` (q,) of the dense part, the robot's pose first."""

    rows: np.ndarray
    cameras: tuple[str, ...]
    columns: np.ndarray
    information: Array


def visits(
    world: GuidanceWorld,
    layout: Layout,
    place: RobotPlace,
    chosen: Candidates,
    cameras: list[str],
) -> tuple[Candidates, list[Visits]]:
    """The candidates at which a camera sees the robot, and what each would tell: those together
    that the same cameras see.

    Where there are too many, those that the first camera sees get half of the room.
    """
    seen = {
        name: faces_seen(world, place, chosen.map_from_base, name, world.state.cameras[name])
        for name in cameras
    }
    kept = _kept(np.stack([faces.whole.any(axis=1) for faces in seen.values()]))
    chosen = chosen.where(kept)
    told = [
        _told(world, layout, place, name, chosen.map_from_base, faces.shown[kept])
        for name, faces in seen.items()
    ]
    is_seen = np.stack([each.is_seen for each in told])
    kept = np.flatnonzero(is_seen.any(axis=0))
    sets, of_set = np.unique(is_seen[:, kept], axis=1, return_inverse=True)
    found = []
    for number, those in enumerate(sets.T):
        rows = np.flatnonzero(of_set == number)
        names = tuple(name for name, is_one in zip(cameras, those, strict=True) if is_one)
        columns = np.unique(np.concatenate([told[i].columns for i in np.flatnonzero(those)]))
        last = layout.last[place.robot]
        columns = np.concatenate([last, columns[~np.isin(columns, last)]])
        place_of = {column: row for row, column in enumerate(columns.tolist())}
        information = np.zeros((len(rows), len(columns), len(columns)))
        for camera in np.flatnonzero(those):
            at = np.array([place_of[column] for column in told[camera].columns.tolist()])
            information[:, at[:, None], at] += told[camera].information[kept[rows]]
        found.append(Visits(rows, names, columns, information))
    return chosen.where(kept), found


def _kept(every: np.ndarray) -> np.ndarray:
    """The candidates that any camera sees, by `every` (cameras, n) bool; a bounded number."""
    first = np.flatnonzero(every[0])
    others = np.flatnonzero(every.any(axis=0) & ~every[0])
    half = _MOST_VISITS // 2
    room = _MOST_VISITS - min(len(first), max(half, _MOST_VISITS - len(others)))
    parts = [first[thinned(len(first), _MOST_VISITS - room)], others[thinned(len(others), room)]]
    return np.sort(np.concatenate(parts))


class FacesSeen(Struct, frozen=True):
    """Which faces a camera sees wholly at each pose, and which at least in part; (n, faces) bool
    each."""

    whole: np.ndarray
    shown: np.ndarray


def faces_seen(
    world: GuidanceWorld, place: RobotPlace, poses: Pose, camera: str, state: CameraState
) -> FacesSeen:
    """What a camera is expected to see from poses (n); nothing far from where it saw before."""
    views = world.views[camera].places
    faces = place.target.faces
    found = FacesSeen(*(np.zeros((len(poses), len(faces)), dtype=bool) for _ in range(2)))
    rows = np.flatnonzero(are_near(poses.translation, views, SEEN_M))
    base_from_face = world.state.robots[place.robot].base_from_face
    for index, face in enumerate(faces):
        if len(rows):
            whole, shown = _sees(state, poses[rows] @ base_from_face[index], face)
            found.whole[rows, index], found.shown[rows, index] = whole, shown
    return found


def _sees(camera: CameraState, map_from_face: Pose, face: Face) -> tuple[np.ndarray, np.ndarray]:
    """Whether a face that shows its front and is large enough is wholly in the picture, and whether
    at least one of its outermost corners or its middle is; (n,) each."""
    corners = face.corners
    across = corners[:, 0] - corners[:, 1]
    extremes = corners[[0, int(np.argmax(across)), len(corners) - 1, int(np.argmin(across))]]
    points = map_from_face @ np.vstack([extremes, extremes.mean(axis=0)])[None]
    sight = camera.map_from_camera.translation - points[:, -1]
    distance = np.maximum(np.linalg.norm(sight, axis=1), 1e-6)
    cosine = -np.sum(map_from_face.rotation[..., 2] * sight, axis=1) / distance
    square = camera.lens.fx * face.square * cosine / distance
    shows = (cosine >= _STEEPEST_COSINE) & (square >= _LEAST_SQUARE_PX)
    inside = _inside(camera, points)
    return shows & inside[:, :-1].all(axis=1), shows & inside.any(axis=1)


def _inside(camera: CameraState, points_map: Array) -> np.ndarray:
    """Which points (n, k, 3) in the map are well in the picture, (n, k)."""
    return camera.lens.sees(camera.map_from_camera.inverse() @ points_map, margin_px=_MARGIN_PX)


class _Told(Struct, frozen=True):
    """What a picture by one camera tells at each pose (n): `information` (n, q, q) over `columns`
    (q,), nothing where the robot is not seen."""

    is_seen: np.ndarray
    columns: np.ndarray
    information: Array


def _told(
    world: GuidanceWorld,
    layout: Layout,
    place: RobotPlace,
    camera: str,
    poses: Pose,
    shown: np.ndarray,
) -> _Told:
    """What a picture at each pose (n) tells of which these faces (n, faces) are shown."""
    rows, last = np.flatnonzero(shown.any(axis=1)), layout.last[place.robot]
    # A robot that stands says nothing of a camera's clock.
    standing = replace(layout, time_offset={})
    found = _Told(np.zeros(len(poses), dtype=bool), last, np.zeros((len(poses), 0, 0)))
    for start in range(0, len(rows), _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        robot = replace(world.state.robots[place.robot], map_from_base=poses[some])
        state = State(world.state.cameras, world.state.robots | {place.robot: robot})
        batch = _batch(world, place, camera, robot, shown[some])
        chain = _chain(place, len(some))
        problem = Problem({place.robot: chain}, (batch,), Priors.none(), standing)
        jacobian, _, columns = batch_jacobian(problem, batch, state)
        if not found.information.size:
            columns = np.concatenate([last, columns])
            found = _Told(found.is_seen, columns, np.zeros((len(poses), *(2 * (len(columns),)))))
        flat = jacobian.reshape(len(some), -1, jacobian.shape[-1])
        found.information[some] = np.swapaxes(flat, 1, 2) @ flat
        found.is_seen[some] = (batch.weights > 0).any(axis=1)
    return found


def _batch(
    world: GuidanceWorld, place: RobotPlace, camera: str, robot: RobotState, shown: np.ndarray
) -> Batch:
    """A synthetic picture at each of the robot's n poses, with the corners that it would show."""
    used = np.flatnonzero(shown.any(axis=0)).tolist()
    corners = [place.target.faces[i].corners for i in used]
    points = np.concatenate(corners)
    faces = np.repeat(used, [len(c) for c in corners])
    seen = np.concatenate(
        [_corners_seen(world.state.cameras[camera], place, robot, i, shown[:, i]) for i in used],
        axis=1,
    )
    n, count = seen.shape
    return Batch(
        camera=camera,
        robot=place.robot,
        nodes=np.arange(n),
        face_points=np.broadcast_to(points, (n, count, 3)),
        faces=np.broadcast_to(faces, (n, count)),
        pixels=np.zeros((n, count, 2)),
        weights=seen / world.views[camera].sigma_px,
        shares=np.ones(n),
        sources=np.zeros(n, dtype=int),
        since_epoch_s=np.zeros(n),
    )


def _corners_seen(
    camera: CameraState, place: RobotPlace, robot: RobotState, index: int, shown: np.ndarray
) -> np.ndarray:
    """Which corners of a face are found at each pose, (n, corners): of a checkerboard all or none,
    of a marked board those in the picture."""
    face = place.target.faces[index]
    map_from_face = robot.map_from_base @ robot.base_from_face[index]
    inside = _inside(camera, map_from_face @ face.corners[None]) & shown[:, None]
    needed = len(face.corners) if face.pattern is Pattern.CHECKERBOARD else _FEWEST_CORNERS
    return inside & (inside.sum(axis=1) >= needed)[:, None]


def _chain(place: RobotPlace, count: int) -> Chain:
    """Nodes at which the robot stands still."""
    track = OdometryTrack(place.noise, planar=place.planar)
    return Chain.unlinked(place.robot, np.arange(count), track)
