"""The current interpretation of a visit, on the way to one of its modes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from trigpoint.fusion.model.observations import Observation, Reading
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.reading.best_readings import read_where_they_are
from trigpoint.fusion.reading.faces import readings_rms_px
from trigpoint.fusion.reading.visibility import body_of
from trigpoint.geometry import CameraModel, Pose
from trigpoint.site.target import Target

Readings = tuple[tuple[Reading, ...], list[float]]


@dataclass(slots=True)
class Trial:
    """How each picture is currently read, and which of its views are taken to be wrong. `hidden`:
    views that could not be seen by any reading, whose linearisation is meaningless; `faces`:
    base_from_face of all faces as last solved, where they are estimated."""

    wrong: dict[int, list[bool]]
    poses: dict[int, Pose]
    readings: dict[int, list[Reading]] = field(default_factory=dict)
    wild: dict[int, list[np.ndarray]] = field(default_factory=dict)
    hidden: set[tuple[int, int]] = field(default_factory=set)
    faces: Pose | None = None

    @property
    def is_all_wrong(self) -> bool:
        """Whether no view is right."""
        return all(all(row) for row in self.wrong.values())

    @property
    def wrong_count(self) -> int:
        """How many views are wrong."""
        return sum(sum(row) for row in self.wrong.values())

    @property
    def signature(self) -> tuple[object, ...]:
        """All that its solution depends on, except where the solver starts."""
        return (
            tuple((index, tuple(row)) for index, row in self.readings.items()),
            tuple(tuple(row) for row in self.wrong.values()),
            tuple(wild.tobytes() for row in self.wild.values() for wild in row),
        )

    def read(
        self, observations: Mapping[int, Observation], target: Target, camera: CameraState
    ) -> None:
        """Read each view as it fits best with the present poses of robot and camera."""
        self.hidden.clear()
        stood = Pose.stack([self.poses[index] for index in observations])
        camera_from_base = camera.map_from_camera.inverse() @ stood
        seen = list(observations.values())
        if self.faces is None:
            read = read_where_they_are(seen, target, camera.lens, camera_from_base)
        else:
            read = _read_by(self.faces, seen, target, camera.lens, camera_from_base)
        for (index, observation), (readings, rms) in zip(observations.items(), read, strict=True):
            self.readings[index] = list(readings)
            hidden = [not np.isfinite(each) for each in rms]
            self.hidden.update((index, order) for order in np.flatnonzero(hidden).tolist())
            before = self.wrong.get(index, hidden)
            self.wrong[index] = [a or b for a, b in zip(before, hidden, strict=True)]
            if index not in self.wild:
                self.wild[index] = [np.zeros(len(v.corners), bool) for v in observation.views]


def _read_by(
    faces: Pose,
    observations: list[Observation],
    target: Target,
    lens: CameraModel,
    camera_from_base: Pose,
) -> list[Readings]:
    """Each observation's readings that fit best with the faces' present estimates, and their RMS
    (pixels)."""
    found = []
    shift = faces @ body_of(target).face_from_base
    for row, observation in enumerate(observations):
        readings, least = [], []
        for view in observation.views:
            each = readings_rms_px(view, target, lens, camera_from_base[row] @ shift)
            rms = [float(each[r.face, order]) for order, r in enumerate(view.readings)]
            readings.append(view.readings[int(np.argmin(rms))])
            least.append(min(rms))
        found.append((tuple(readings), least))
    return found
