"""What a camera sees of a target at many places at once, and the information in that.

A face is found where it turns its front to the camera by more than 15°, the smallest side of its
squares (or tags) is at least 7 pixels long, and enough of its corners lie in the picture, 5 pixels
off its edge, with no other face in between: all of a checkerboard, six of a marked board. These are
the rules by which the simulated lab's detector finds faces (`tools/simulation`); walls are not
known. Which face it is, is taken as known: a robot's odometry tells that apart.

All places have the same few headings, so what a face's points add to the robot's place in the
camera's frame is worked out once for each heading.
"""

import numpy as np
from msgspec import Struct

from trigpoint.fusion.model.projection import projected
from trigpoint.fusion.reading.visibility import Body, corners_hidden
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array, about_z

from .boards import Board, Carried
from .eye import LEAST_SIDE_PX, Eye

STEEPEST_COSINE = 0.26  # of the angle between a face's normal and the line of sight: 75°
HEADINGS = 8


def headings_rad(count: int = HEADINGS) -> Array:
    """So many headings, evenly around, (count,)."""
    return np.arange(count) * 2 * np.pi / count


class Seen(Struct, frozen=True, eq=False):
    """Where a camera finds a face: `rows` (k,) among places × headings, those of a place together,
    and the information (k, 6, 6) of its picture on the disturbance of the robot's pose there."""

    rows: np.ndarray
    information: Array


def seen_by(eye: Eye, carried: Carried, places: Array, headings_rad: Array) -> Seen:
    """What a camera sees of a target at places (n, 2), in each of some headings (h,)."""
    look = _Look(eye, carried, places, headings_rad)
    count = len(places) * len(headings_rad)
    information, is_found = np.zeros((count, 6, 6)), np.zeros(count, dtype=bool)
    for index in range(len(carried.boards)):
        for rows, found in look.at_board(index):
            information[rows] += found
            is_found[rows] = True
    rows = np.flatnonzero(is_found)
    return Seen(rows, information[rows])


class _Look:
    """One camera, one target, many places."""

    def __init__(self, eye: Eye, carried: Carried, places: Array, headings_rad: Array) -> None:
        self._eye, self._carried = eye, carried
        self._turns = about_z(headings_rad)
        self._base = np.column_stack([places, np.zeros(len(places))])
        self._to_eye = eye.map_from_camera.translation - self._base
        self._in_camera = -self._to_eye @ eye.map_from_camera.rotation

    def at_board(self, index: int) -> list[tuple[np.ndarray, Array]]:
        """The rows at which a face is found, and the information there, in two parts: those where
        all of it is seen, and those where some."""
        board = self._carried.boards[index]
        place, heading = self._showing(board)
        if not len(place):
            return []
        is_whole = self._is_inside(board, place, heading)
        eyes = self._eyes_in_base(place, heading)
        if board.hiders:
            is_whole &= ~_may_be_covered(self._carried.body, board, eyes)
        found = []
        if np.any(is_whole):
            one = np.full((int(is_whole.sum()), 4), board.node_weight)
            found.append(self._told(board, board.nodes, place[is_whole], heading[is_whole], one))
        rest = ~is_whole
        if np.any(rest):
            seen = self._eye.shows(self._optical(board, board.corners, place[rest], heading[rest]))
            if board.hiders:
                seen &= ~corners_hidden(self._carried.body, index, eyes[rest], board.hiders)
            enough = seen.sum(axis=1) >= board.needed
            where = np.flatnonzero(rest)[enough]
            if len(where):
                weights = seen[enough].astype(float)
                found.append(
                    self._told(board, board.corners, place[where], heading[where], weights)
                )
        return found

    def _showing(self, board: Board) -> tuple[np.ndarray, np.ndarray]:
        """Places and headings (k,) at which a face turns its front to the camera and is large
        enough."""
        into = self._turns @ board.base_from_face.rotation[:, 2]
        middle = self._turns @ (board.base_from_face @ board.middle)
        ahead = np.sum(into * middle, axis=1) - self._to_eye @ into.T
        squared = np.sum(self._to_eye**2, axis=1)[:, None] - 2 * self._to_eye @ middle.T
        distance = np.sqrt(np.maximum(squared + np.sum(middle**2, axis=1), 1e-12))
        cosine = ahead / distance
        is_near = distance - board.reach_m <= self._eye.reach_m(board.face.square)
        place, heading = np.nonzero((cosine > STEEPEST_COSINE) & is_near)
        cosine, distance = cosine[place, heading], distance[place, heading]
        # The smallest side is shortened by no more than the steepest part of the face is turned.
        turned = np.arccos(np.minimum(cosine, 1.0))
        turned += np.arcsin(np.minimum(board.reach_m / distance, 1.0))
        least = np.cos(np.minimum(turned, np.pi / 2)) * board.face_side_m
        least *= self._eye.scale_px[0] / (distance + board.reach_m)
        kept = least >= LEAST_SIDE_PX
        near = np.flatnonzero(~kept)
        kept[near] = self._is_large(board, place[near], heading[near])
        return place[kept], heading[kept]

    def _is_large(self, board: Board, place: np.ndarray, heading: np.ndarray) -> np.ndarray:
        ends = self._optical(board, board.sides.reshape(-1, 3), place, heading)
        ahead = np.all(ends[..., 2] > 1e-6, axis=1)
        pixels = self._eye.lens.project(np.where(ahead[:, None, None], ends, [0.0, 0.0, 1.0]))
        pixels = pixels.reshape(len(place), len(board.sides), 2, 2)
        shortest = np.linalg.norm(pixels[:, :, 1] - pixels[:, :, 0], axis=-1).min(axis=1)
        return ahead & (shortest >= LEAST_SIDE_PX)

    def _is_inside(self, board: Board, place: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Whether all of a face is well in the picture, (k,)."""
        middle = self._optical(board, board.middle[None], place, heading)[:, 0]
        distance = np.maximum(np.linalg.norm(middle, axis=1), 1e-9)
        off_axis = np.arccos(np.clip(middle[:, 2] / distance, -1, 1))
        off_axis += np.arcsin(np.minimum(board.reach_m / distance, 1.0))
        inside = off_axis < self._eye.narrowest_rad
        near = np.flatnonzero(~inside)
        ends = self._optical(board, board.extremes, place[near], heading[near])
        inside[near] = self._eye.shows(ends).all(axis=1)
        return inside

    def _optical(
        self, board: Board, points: Array, place: np.ndarray, heading: np.ndarray
    ) -> Array:
        """Points (m, 3) of a face in the camera's frame, (k, m, 3)."""
        in_base = board.base_from_face @ points
        turned = in_base @ np.swapaxes(self._turns, 1, 2) @ self._eye.map_from_camera.rotation
        return self._in_camera[place, None] + turned[heading]

    def _eyes_in_base(self, place: np.ndarray, heading: np.ndarray) -> Array:
        """The camera in the robot's frame, (k, 3)."""
        return np.einsum("kji,kj->ki", self._turns[heading], self._to_eye[place])

    def _told(
        self,
        board: Board,
        points: Array,
        place: np.ndarray,
        heading: np.ndarray,
        weights: Array,
    ) -> tuple[np.ndarray, Array]:
        """Rows, and the information (k, 6, 6) on the robot's pose in points (m, 3) of a face that
        each count as so many corners (k, m)."""
        poses = Pose(self._turns[heading], self._base[place])
        in_base = board.base_from_face @ points
        found = projected(self._eye.lens, poses, in_base[None], self._eye.map_from_camera)
        jacobian = found.by_body * (np.sqrt(weights) / self._eye.sigma_px)[..., None, None]
        flat = jacobian.reshape(len(place), 2 * len(points), 6)
        return place * len(self._turns) + heading, np.swapaxes(flat, 1, 2) @ flat


def _may_be_covered(body: Body, board: Board, eyes: Array) -> np.ndarray:
    """Whether another face may cover some corner of a board, as eyes (n, 3) in the base frame see
    it; (n,). By the box around the other's shadow in the board's plane, so some that only come near
    are included."""
    face_from_base = board.base_from_face.inverse()
    seen_from = eyes @ face_from_base.rotation.T + face_from_base.translation
    height = -seen_from[:, None, 2]  # over the board, whose z points into it
    low, high = board.corners[:, :2].min(axis=0), board.corners[:, :2].max(axis=0)
    covered = np.zeros(len(eyes), dtype=bool)
    for other in board.hiders:
        outline = face_from_base @ _outline(body, other)
        over = np.clip(-outline[:, 2], 0.0, None)
        share = height / np.maximum(height - over, 1e-9)
        start = seen_from[:, None, :2]
        shadow = start + share[..., None] * (outline[:, :2] - start)
        meets = (shadow.min(axis=1) <= high) & (shadow.max(axis=1) >= low)
        reaches_up = np.any(over >= height, axis=1)  # beside or above the eye: no shadow ends
        covered |= np.all(meets, axis=1) | reaches_up
    return covered


def _outline(body: Body, face: int) -> Array:
    """The rectangle of a face's pattern in the base frame, (4, 3)."""
    (x0, y0), (x1, y1) = body.low[face], body.high[face]
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])
    return body.base_from_face[face] @ corners
