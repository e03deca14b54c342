"""Faces most of whose sightings contradict the rest: wrong ones are rare, and not one face's."""

from collections import Counter, defaultdict
from collections.abc import Iterator

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, Verdict

# So many are no accident: of a face, of all of a target; and of those that were seen. What one
# camera alone contradicts may be the camera's fault, or one bad passing's.
_LEAST_OF_FACE, _LEAST_OF_ALL, _LEAST_CAMERAS = 3, 6, 2
_MOST_OF_FACE, _MOST_OF_ALL = 3 / 4, 1 / 3
_Seen = Counter[tuple[str, int]]
_Against = defaultdict[tuple[str, int], list[str]]
"""Robot and face -> the camera of each sighting that contradicts the rest."""


def rejected_faces(data: DataSet) -> tuple[str, ...]:
    """A line for each face that what else was seen contradicts, or one for a robot's target, where
    that holds for other faces too; of sightings whose camera is located and whose face the picture
    tells."""
    seen, against = _Seen(), _Against(list)
    for entry in data.entries:
        _count(entry.observation, seen, against)
    return tuple(line for robot in data.site.robots for line in _lines(data, robot, seen, against))


def _count(observation: Observation, seen: _Seen, against: _Against) -> None:
    if observation.verdict is Verdict.PENDING or observation.is_repeat:
        return
    is_whole = observation.verdict is Verdict.REJECTED
    for number, view in enumerate(observation.views):
        faces = {reading.face for reading in view.readings}
        if len(faces) > 1:
            continue
        key = (observation.robot, faces.pop())
        seen[key] += 1
        wild = observation.outliers[number] if observation.outliers else None
        if is_whole or (wild is not None and bool(wild.all())):
            against[key].append(observation.camera)


def _lines(data: DataSet, robot: str, seen: _Seen, against: _Against) -> Iterator[str]:
    mine = [key for key in seen if key[0] == robot]
    if len({camera for key in mine for camera in against[key]}) < _LEAST_CAMERAS:
        return
    wrong = [
        key
        for key in mine
        if len(against[key]) >= _LEAST_OF_FACE
        and len(against[key]) > _MOST_OF_FACE * seen[key]
        and len(set(against[key])) >= _LEAST_CAMERAS
    ]
    others = [key for key in mine if key not in wrong]
    bad = sum(len(against[key]) for key in others)
    if bad >= _LEAST_OF_ALL and bad > _MOST_OF_ALL * sum(seen[key] for key in others):
        count, bad = sum(seen[key] for key in mine), sum(len(against[key]) for key in mine)
        yield (
            f"{bad} of {count} sightings of {robot} contradict the rest; measure the squares of "
            "its print (printers scale), and compare the faces' places in the target file and the "
            "lens with what is there"
        )
        return
    for key in wrong:
        face, bad = data.targets[robot].faces[key[1]].id, len(against[key])
        yield (
            f"{bad} of {seen[key]} sightings of face {face} of {robot} contradict the rest; "
            "compare its translation, quaternion and size in the target file with the robot: two "
            "faces may be exchanged, or one upside down"
        )
