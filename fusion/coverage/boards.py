"""A target's faces as they are looked at from many places: which of their corners decide whether a
face is found, and a few points that weigh as much as all of its corners."""

from functools import cached_property

import numpy as np
from msgspec import Struct

from trigpoint.fusion.reading.visibility import Body
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Pattern, Target

FEWEST_CORNERS = 6
"""Of a marked board that is seen in part."""
_BEFORE_M = 1e-4


class Board(Struct, frozen=True, eq=False, dict=True):
    """One face. `corners` (n, 3), `extremes` (4, 3): those farthest out; `sides` (s, 2, 3): the
    ends of the sides of the squares (or tags) in its four corners, among which is the smallest one
    in any picture; `needed`: how many corners must be seen; `hiders`: the faces that can stand
    before it.

    `nodes` (4, 3), each of the weight `node_weight`: the Gauss quadrature of its corners. They have
    the corners' moments up to the third, and the information in a corner hardly differs from a
    polynomial of that degree over a board: so four points weigh as much as 12 or 48.
    """

    face: Face
    base_from_face: Pose
    corners: Array
    extremes: Array
    sides: Array
    needed: int
    nodes: Array
    node_weight: float
    hiders: tuple[int, ...]

    @cached_property
    def middle(self) -> Array:
        """The middle of its corners, (3,)."""
        return self.nodes.mean(axis=0)

    @cached_property
    def reach_m(self) -> float:
        """The distance of the farthest corner from the middle."""
        return float(np.linalg.norm(self.corners - self.middle, axis=1).max())

    @cached_property
    def face_side_m(self) -> float:
        """The side of a square, or of a tag."""
        return float(np.linalg.norm(self.sides[:, 1] - self.sides[:, 0], axis=1).min())


class Carried(Struct, frozen=True, eq=False, dict=True):
    """What robots carry. `robots`: who; `target`: the faces; `base_from_face` (f): as they were
    found to be mounted; `tangent`: the components of their pose that are free."""

    robots: tuple[str, ...]
    target: Target
    base_from_face: Pose
    tangent: tuple[int, ...]

    @cached_property
    def body(self) -> Body:
        """The target as an opaque body."""
        counts = np.array([face.corner_count for face in self.target.faces])
        table = np.zeros((len(counts), counts.max(), 3))
        for index, face in enumerate(self.target.faces):
            table[index, : face.corner_count] = self.base_from_face[index] @ face.corners
        outlines = np.stack([face.outline[:, :2] for face in self.target.faces])
        return Body(
            table,
            counts,
            self.base_from_face,
            self.base_from_face.inverse(),
            outlines.min(axis=1),
            outlines.max(axis=1),
        )

    @cached_property
    def boards(self) -> tuple[Board, ...]:
        """Its faces."""
        return tuple(self._board(index) for index in range(len(self.target.faces)))

    @cached_property
    def ball(self) -> tuple[float, float, float]:
        """Everything that it shows, whatever the heading: the height of the middle, the greatest
        distance from there, and the largest square; metres."""
        points = np.concatenate([b.base_from_face @ b.corners for b in self.boards])
        height = float((points[:, 2].min() + points[:, 2].max()) / 2)
        reach = float(np.linalg.norm(points - [0.0, 0.0, height], axis=1).max())
        return height, reach, max(face.square for face in self.target.faces)

    def _board(self, index: int) -> Board:
        face, corners = self.target.faces[index], self.target.faces[index].corners
        across = corners[:, 0] - corners[:, 1]
        along = corners[:, 0] + corners[:, 1]
        ends = [
            int(along.argmin()),
            int(across.argmax()),
            int(along.argmax()),
            int(across.argmin()),
        ]
        is_whole = face.pattern is Pattern.CHECKERBOARD
        middle, spread = corners.mean(axis=0), corners.std(axis=0)
        signs = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return Board(
            face,
            self.base_from_face[index],
            corners,
            corners[ends],
            _sides(face, corners, ends),
            face.corner_count if is_whole else min(FEWEST_CORNERS, face.corner_count),
            middle + signs * spread,
            face.corner_count / 4,
            tuple(other for other in range(len(self.target.faces)) if self._may_hide(other, index)),
        )

    def _may_hide(self, other: int, face: int) -> bool:
        """Whether any part of another face lies before a face's front."""
        if other == face:
            return False
        outline = self.base_from_face[other] @ self.target.faces[other].outline
        return bool((self.base_from_face[face].inverse() @ outline)[:, 2].min() < -_BEFORE_M)


def _sides(face: Face, corners: Array, ends: list[int]) -> Array:
    """The sides of the squares, or tags, at a face's outermost corners; see `Board`."""
    if face.pattern is Pattern.APRILGRID:
        tags = {4 * (end // 4) for end in ends}
        pairs = [(tag + k, tag + (k + 1) % 4) for tag in sorted(tags) for k in range(4)]
        return corners[np.array(pairs)]
    columns, rows = face.columns - 1, face.rows - 1
    pairs = []
    for end in ends:
        row, column = divmod(end, columns)
        if columns > 1:
            pairs.append((end, end + (1 if column == 0 else -1)))
        if rows > 1:
            pairs.append((end, end + columns * (1 if row == 0 else -1)))
    return corners[np.array(pairs, dtype=int).reshape(-1, 2)]
