"""What the viewer would send to rerun, kept."""

from typing import Any

import numpy as np
import rerun as rr

from trigpoint.contract.messages import PoseEstimate
from trigpoint.geometry import Pose
from trigpoint.recorder.viewer.columns import Columns

SECOND = 1_000_000_000


class FixedRows(Columns):
    """Keeps what holds at every time in place of sending it."""

    def __init__(self) -> None:
        self.meshes: dict[str, list[rr.Mesh3D]] = {}

    def fixed(self, entity: str, archetype: rr.AsComponents) -> None:
        if isinstance(archetype, rr.Mesh3D):
            self.meshes.setdefault(entity, []).append(archetype)


class Rows(Columns):
    """Keeps the rows in place of sending them."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, int, type, dict[str, Any]]] = []

    def row(self, entity: str, time_ns: int, archetype: type, /, **components: Any) -> None:
        self.rows.append((entity, time_ns, archetype, components))

    def picture(self, entity: str, time_ns: int, data: bytes) -> None:
        self.row(entity, time_ns, rr.EncodedImage, blob=[data])

    def of(self, entity: str) -> list[tuple[int, dict[str, Any]]]:
        return [(time_ns, parts) for path, time_ns, _, parts in self.rows if path == entity]


def estimate(t: float, x: float, sigma: float = 0.01) -> PoseEstimate:
    return PoseEstimate(round(t * SECOND), "map", Pose.planar(x, 0, 0), sigma**2 * np.eye(6))
