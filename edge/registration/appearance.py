"""The looks of faces: what can be told apart in a picture, and whose it is."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from trigpoint.contract.messages import FaceSighting
from trigpoint.site.target import Face, Target


class Appearance(Struct, frozen=True):
    """One look that a face can have, and whose it is.

    `target`: the target's name, "" where several robots carry the look; `face_id`: the face's id,
    -1 where faces of different ids look alike. `face` is one of those that look so.
    """

    face: Face
    target: str
    face_id: int

    @property
    def is_unique(self) -> bool:
        """Whether only one face of one robot looks so, which a picture shows once at most."""
        return self.target != "" and self.face_id >= 0

    @property
    def words(self) -> str:
        """The face by its id and target, for people."""
        of = f" of target «{self.target}»" if self.target else ""
        return f"face {self.face.id}{of}"

    def sighting(self, corners: np.ndarray, pixels: np.ndarray, sigma: float) -> FaceSighting:
        """A sighting of this look; `corners`: (n,) ids; `pixels`: (n, 2)."""
        return FaceSighting(
            self.target, self.face_id, corners.astype(np.uint16), pixels.astype(np.float32), sigma
        )


def appearances(targets: Sequence[Target]) -> tuple[Appearance, ...]:
    """Every look among the robots' targets, one target a robot, each once."""
    owners: dict[tuple[object, ...], list[tuple[int, Target, Face]]] = {}
    for robot, target in enumerate(targets):
        for face in target.faces:
            owners.setdefault(face.appearance, []).append((robot, target, face))
    return tuple(_appearance(same) for same in owners.values())


def _appearance(same: list[tuple[int, Target, Face]]) -> Appearance:
    robots = {robot for robot, _, _ in same}
    ids = {face.id for _, _, face in same}
    alone = len(same) == len(robots)
    _, target, face = same[0]
    return Appearance(
        face=face,
        target=target.name if len(robots) == 1 else "",
        face_id=face.id if len(ids) == 1 and alone else -1,
    )
