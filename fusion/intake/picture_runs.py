"""Pictures of one camera in order of time: by visit, and what is left of a run of them once a robot
was told from it."""

from collections.abc import Iterable

from trigpoint.base.clock import to_ns
from trigpoint.fusion.association.robots import Picture
from trigpoint.fusion.model.observations import Observation, observation_of

AWAY_NS = to_ns(2.0)
"""A robot that was not seen for so long has left."""
# With one sighting in ten wrong, so many in a row are wrong one time in a thousand.
_LEAST_LASTING = 3
# ... and not expected more often than this among wrong sightings that come singly.
_CHANCE = 0.1


def lasting(run: list[Picture], left: list[Picture]) -> list[Picture]:
    """What was left of the longest stretch of a run in which something was left of each picture:
    wrong sightings come singly, but a camera that was moved or a robot that was lifted stays so,
    whatever other robots are beside it."""
    over: dict[int, Picture] = {}
    for picture in left:
        mine = over.get(picture.stamp_ns, Picture(picture.stamp_ns, ()))
        over[picture.stamp_ns] = Picture(picture.stamp_ns, mine.faces + picture.faces)
    stretches: list[list[Picture]] = [[]]
    for picture in run:
        if picture.stamp_ns in over:
            stretches[-1].append(over[picture.stamp_ns])
        else:
            stretches.append([])
    longest = max(stretches, key=len)
    count = len(longest)
    share = (len(over) - count + 1) / (len(run) - count + 2)  # of the other pictures (Laplace)
    is_chance = count < _LEAST_LASTING or len(run) * share**count > _CHANCE
    return [] if is_chance else longest


def split(
    camera: str, robot: str, right: dict[int, tuple[int, ...]], visit: list[Picture]
) -> tuple[list[Observation], list[Picture]]:
    """The observations of a robot, given which faces are its own, and the pictures with the
    faces left."""
    found, rest = [], []
    for order, picture in enumerate(visit):
        own = right.get(order, ())
        if own:
            views = tuple(picture.faces[face][robot] for face in own)
            found.append(observation_of(camera, robot, picture.stamp_ns, views))
        others = [face for face in range(len(picture.faces)) if face not in own]
        if others:
            rest.append(picture.showing(others))
    return found, rest


def visits(left: Iterable[tuple[str, Picture]]) -> list[tuple[str, list[Picture]]]:
    """Pictures by camera and visit, each in order of time."""
    visits: list[tuple[str, list[Picture]]] = []
    last: dict[str, list[Picture]] = {}
    for camera, picture in sorted(left, key=lambda item: item[1].stamp_ns):
        visit = last.get(camera)
        if visit is None or picture.stamp_ns - visit[-1].stamp_ns > AWAY_NS:
            visit = last[camera] = []
            visits.append((camera, visit))
        visit.append(picture)
    return visits
