"""What cameras would see of a robot at candidate poses, and the information in that."""

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from trigpoint.fusion.model.odometry import OdometryTrack
from trigpoint.fusion.model.places import are_near
from trigpoint.fusion.model.prediction import batch_jacobian
from trigpoint.fusion.model.problem import (
    Batch,
    Chain,
    Layout,
    Priors,
    Problem,
    State,
)
from trigpoint.fusion.model.thinning import thinned
from trigpoint.fusion.reading.sight import Eye, Faces, Rules, corners_found
from trigpoint.fusion.solver.snapshot import GuidanceWorld, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.samples import unique

from .candidates import SEEN_M, Candidates

# A pose is a candidate where a face is found whole, with some room for what is not exactly as
# expected.
_WITH_ROOM = Rules(least_cosine=0.35, least_side_px=8.0, margin_px=8.0)
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
    counts = [face.corner_count for face in place.target.faces]
    faces = Faces(place.target, world.state.robots[place.robot].base_from_face)
    seen = {name: _corners(world, faces, chosen.map_from_base, name) for name in cameras}
    whole = [(found.sum(axis=2) == counts).any(axis=1) for found in seen.values()]
    kept = _kept(np.stack(whole))
    chosen = chosen.where(kept)
    told = [
        _told(world, layout, place, name, chosen.map_from_base, found[kept])
        for name, found in seen.items()
    ]
    is_seen = np.stack([each.is_seen for each in told])
    kept = np.flatnonzero(is_seen.any(axis=0))
    sets, of_set = np.unique(is_seen[:, kept], axis=1, return_inverse=True)
    found = []
    for number, those in enumerate(sets.T):
        rows = np.flatnonzero(of_set == number)
        names = tuple(name for name, is_one in zip(cameras, those, strict=True) if is_one)
        columns = unique(np.concatenate([told[i].columns for i in np.flatnonzero(those)]))
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


def _corners(world: GuidanceWorld, faces: Faces, poses: Pose, camera: str) -> np.ndarray:
    """Which corners (n, f, c) of a robot's faces a camera is expected to find at its poses (n);
    nothing far from where it saw before."""
    views, state = world.views[camera], world.state.cameras[camera]
    found = np.zeros((len(poses), *faces.shape), dtype=bool)
    rows = np.flatnonzero(are_near(poses.translation, views.places, SEEN_M))
    eye = Eye(camera, state.map_from_camera, state.lens, views.sigma_px)
    found[rows] = corners_found(eye, faces, poses[rows], _WITH_ROOM)
    return found


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
    seen: np.ndarray,
) -> _Told:
    """What a picture at each pose (n) tells in which these corners (n, f, c) are found."""
    rows, last = np.flatnonzero(seen.any(axis=(1, 2))), layout.last[place.robot]
    # A robot that stands says nothing of a camera's clock.
    standing = replace(layout, time_offset={})
    found = _Told(np.zeros(len(poses), dtype=bool), last, np.zeros((len(poses), 0, 0)))
    for start in range(0, len(rows), _AT_ONCE):
        some = rows[start : start + _AT_ONCE]
        robot = replace(world.state.robots[place.robot], map_from_base=poses[some])
        state = State(world.state.cameras, world.state.robots | {place.robot: robot})
        batch = _batch(world, place, camera, seen[some])
        chain = _chain(place, len(some))
        problem = Problem({place.robot: chain}, (batch,), Priors.none(), standing)
        jacobian, _, columns = batch_jacobian(problem, batch, state)
        if not found.information.size:
            columns = np.concatenate([last, columns])
            found = _Told(found.is_seen, columns, np.zeros((len(poses), *(2 * (len(columns),)))))
        flat = jacobian.reshape(len(some), -1, jacobian.shape[-1])
        found.information[some] = np.swapaxes(flat, 1, 2) @ flat
        found.is_seen[some] = True
    return found


def _batch(world: GuidanceWorld, place: RobotPlace, camera: str, seen: np.ndarray) -> Batch:
    """A synthetic picture at each of the robot's n poses, in which corners (n, f, c) are found."""
    used = np.flatnonzero(seen.any(axis=(0, 2))).tolist()
    corners = [place.target.faces[i].corners for i in used]
    points = np.concatenate(corners)
    faces = np.repeat(used, [len(c) for c in corners])
    found = [seen[:, i, : len(c)] for i, c in zip(used, corners, strict=True)]
    shown = np.concatenate(found, axis=1)
    n, count = shown.shape
    return Batch(
        camera=camera,
        robot=place.robot,
        nodes=np.arange(n),
        face_points=np.broadcast_to(points, (n, count, 3)),
        faces=np.broadcast_to(faces, (n, count)),
        pixels=np.zeros((n, count, 2)),
        weights=shown / world.views[camera].sigma_px,
        shares=np.ones(n),
        sources=np.zeros(n, dtype=int),
        since_epoch_s=np.zeros(n),
    )


def _chain(place: RobotPlace, count: int) -> Chain:
    """Nodes at which the robot stands still."""
    track = OdometryTrack(place.noise, planar=place.planar)
    return Chain.unlinked(place.robot, np.arange(count), track)
