"""From sightings to views: what a calibration of the lens knows of one face in one picture."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import FaceSighting
from trigpoint.geometry.rotation import Array
from trigpoint.site.target import Face, Target

FEWEST_CORNERS = 8
_FLATTEST = 0.05


class View(Struct, frozen=True, eq=False):
    """One face in one picture.

    `points`: (n, 3) in the face's frame, metres, z = 0; `pixels`: (n, 2) float64, raw; `sigma`: of
    one coordinate as the detector says, pixels; `board`: which one it is, where there is only one
    such. The face's pose on the robot is not used, so a target that was put together carelessly
    spoils nothing.
    """

    name: str
    points: Array
    pixels: Array
    sigma: float
    board: tuple[str, int] | None = None

    def __len__(self) -> int:
        return len(self.points)


def views_of(name: str, faces: Sequence[FaceSighting], targets: Sequence[Target]) -> list[View]:
    """The views in one picture: of the faces with corners enough, and not all on a line."""
    found = [(sighting, _face_of(sighting, targets)) for sighting in faces]
    views = [_view(name, sighting, face) for sighting, face in found if face is not None]
    return [view for view in views if _is_usable(view)]


def _view(name: str, sighting: FaceSighting, face: Face) -> View:
    points = face.corners[sighting.corners.astype(int)]
    board = (sighting.target, sighting.face)
    is_only = sighting.target != "" and sighting.face >= 0
    pixels = sighting.pixels.astype(float)
    return View(name, points, pixels, sighting.sigma, board if is_only else None)


def _face_of(sighting: FaceSighting, targets: Sequence[Target]) -> Face | None:
    """A face with the sighting's corners; None where faces of several shapes may be meant.

    Which of several alike it is, and which way up, does not matter: neither the pose nor the size
    of a single plane enters the lens.
    """
    candidates = [
        face
        for target in targets
        if sighting.target in ("", target.name)
        for face in target.faces
        if sighting.face in (-1, face.id) and sighting.corners.max(initial=0) < face.corner_count
    ]
    if sighting.face < 0:
        whole = [face for face in candidates if face.corner_count == len(sighting.corners)]
        candidates = whole or candidates
    shapes = {(face.pattern, face.columns, face.rows) for face in candidates}
    return candidates[0] if len(shapes) == 1 else None


def _is_usable(view: View) -> bool:
    if len(view) < FEWEST_CORNERS:
        return False
    spread = np.linalg.svd(view.points[:, :2] - view.points[:, :2].mean(axis=0), compute_uv=False)
    return bool(spread[1] > _FLATTEST * spread[0])
