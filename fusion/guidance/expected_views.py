"""What cameras would see of a robot at candidate poses, and the information in that."""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.places import are_near
from trigpoint.fusion.model.problem import Layout
from trigpoint.fusion.model.thinning import thinned
from trigpoint.fusion.reading.sight import Eye, Faces, Rules, look
from trigpoint.fusion.solver.snapshot import GuidanceWorld, RobotPlace
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import lever

from .candidates import SEEN_M, Candidates

# A pose is a candidate where a face is found whole, with some room for what is not exactly as
# expected.
_WITH_ROOM = Rules(least_cosine=0.35, least_side_px=8.0, margin_px=8.0)
_MOST_VISITS = 360


class Visits(Struct, frozen=True):
    """What a picture by each of `cameras` would tell at candidates `rows` (m,): information (m, q,
    q) over `columns` (q,) of the dense part, the robot's pose and then the cameras'."""

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
    that the same cameras see. What a picture would tell of lenses and of faces is left out.

    Where there are too many, those that the first camera sees get half of the room.
    """
    faces = Faces(place.target, world.state.robots[place.robot].base_from_face)
    told = [_told(world, faces, chosen.map_from_base, name) for name in cameras]
    kept = _kept(np.stack([is_whole for is_whole, _ in told]))
    is_seen = np.stack([information[kept].any(axis=(1, 2)) for _, information in told])
    seen = is_seen.any(axis=0)
    kept, is_seen = kept[seen], is_seen[:, seen]
    chosen = chosen.where(kept)
    sets, of_set = np.unique(is_seen, axis=1, return_inverse=True)
    found = []
    for number, those in enumerate(sets.T):
        rows = np.flatnonzero(of_set == number)
        names = tuple(name for name, is_one in zip(cameras, those, strict=True) if is_one)
        columns = [layout.last[place.robot], *(layout.pose[name] for name in names)]
        information = np.zeros((len(rows), *(2 * (sum(map(len, columns)),))))
        for order, camera in enumerate(np.flatnonzero(those).tolist()):
            arm = chosen.map_from_base.translation[rows]
            arm = arm - world.state.cameras[names[order]].map_from_camera.translation
            # A camera that is off takes along what it sees.
            by_base = np.tile(np.eye(6)[:, place.tangent], (len(rows), 1, 1))
            by = np.concatenate([by_base, -lever(arm)], axis=2)
            first = len(place.tangent) + 6 * order
            at = np.array([*range(len(place.tangent)), *range(first, first + 6)])
            mine = np.swapaxes(by, 1, 2) @ told[camera][1][kept[rows]] @ by
            information[:, at[:, None], at] += mine
        found.append(Visits(rows, names, np.concatenate(columns), information))
    return chosen, found


def _kept(every: np.ndarray) -> np.ndarray:
    """The candidates that any camera sees, by `every` (cameras, n) bool; a bounded number."""
    first = np.flatnonzero(every[0])
    others = np.flatnonzero(every.any(axis=0) & ~every[0])
    half = _MOST_VISITS // 2
    room = _MOST_VISITS - min(len(first), max(half, _MOST_VISITS - len(others)))
    parts = [first[thinned(len(first), _MOST_VISITS - room)], others[thinned(len(others), room)]]
    return np.sort(np.concatenate(parts))


def _told(world: GuidanceWorld, faces: Faces, poses: Pose, camera: str) -> tuple[np.ndarray, Array]:
    """At which of a robot's poses (n) a camera is expected to find a face whole, bool, and what its
    picture there tells of that pose, (n, 6, 6); nothing far from where it saw before."""
    views, state = world.views[camera], world.state.cameras[camera]
    is_whole, information = np.zeros(len(poses), dtype=bool), np.zeros((len(poses), 6, 6))
    rows = np.flatnonzero(are_near(poses.translation, views.places, SEEN_M))
    eye = Eye(camera, state.map_from_camera, state.lens, views.sigma_px)
    corners, information[rows] = look(eye, faces, poses[rows], _WITH_ROOM)
    counts = [face.corner_count for face in faces.target.faces]
    is_whole[rows] = (corners.sum(axis=2) == counts).any(axis=1)
    return is_whole, information
