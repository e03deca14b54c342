"""Which lift of a robot or move of a camera may be what a visit contradicts.

Robots' visits, tied by odometry, and the cameras that they saw are a graph. What everything agrees
on up to a visit is not suspect: a gap between visits, or a camera between two visits to it, that
lies in a loop of those was driven, or hung, as it is thought to. What the contradicting visit
closes a loop over for the first time may be broken.
"""

from collections import defaultdict
from collections.abc import Hashable, Iterator

from .dataset import DataSet, Knock, Lift, Upheaval
from .visits import Visit

_Edge = tuple[Hashable, Hashable]
_ROOT = "map"


def suspects(
    data: DataSet, visits: list[Visit], agreeing: frozenset[int], events: tuple[Upheaval, ...]
) -> list[Upheaval]:
    """What may be wrong in these visits, beside what is known to have happened.

    `agreeing`: the numbers of the visits that agree with each other.
    """
    before = [visit for number, visit in enumerate(visits) if number in agreeing]
    return [
        event
        for event in [*_lifts(visits), *_knocks(data, visits)]
        if event not in events
        and _closes_loop(data, visits, events, event)
        and not _closes_loop(data, before, events, event)
    ]


def _lifts(visits: list[Visit]) -> Iterator[Lift]:
    for robot in dict.fromkeys(visit.robot for visit in visits):
        until_ns = None
        for visit in (visit for visit in visits if visit.robot == robot):
            if until_ns is not None and visit.first_ns > until_ns:
                yield Lift(robot, until_ns, visit.first_ns)
            until_ns = max(until_ns or visit.last_ns, visit.last_ns)


def _knocks(data: DataSet, visits: list[Visit]) -> Iterator[Knock]:
    for camera in dict.fromkeys(visit.camera for visit in visits):
        mine = [visit for visit in visits if visit.camera == camera]
        if camera in data.known.poses:
            yield Knock(camera, data.epoch_ns, mine[0].first_ns)
        until_ns = mine[0].last_ns
        for visit in mine[1:]:
            if visit.first_ns > until_ns:
                yield Knock(camera, until_ns, visit.first_ns)
            until_ns = max(until_ns, visit.last_ns)


def _closes_loop(
    data: DataSet, visits: list[Visit], events: tuple[Upheaval, ...], suspect: Upheaval
) -> bool:
    """Whether both sides of a suspect are tied to each other without it as well."""
    edges = _edges(data, visits, (*events, suspect))
    ends = _ends(visits, (*events, suspect), suspect)
    return ends is not None and ends[1] in _reached(edges, ends[0])


def _ends(visits: list[Visit], events: tuple[Upheaval, ...], suspect: Upheaval) -> _Edge | None:
    """What is on both sides of a suspect; None where nothing is on one of them."""
    if isinstance(suspect, Knock):
        return (
            _place(events, suspect.camera, suspect.until_ns),
            _place(events, suspect.camera, suspect.since_ns),
        )
    mine = [n for n, visit in enumerate(visits) if visit.robot == suspect.robot]
    earlier = [n for n in mine if visits[n].last_ns <= suspect.after_ns]
    later = [n for n in mine if visits[n].first_ns >= suspect.before_ns]
    return (earlier[-1], later[0]) if earlier and later else None


def _edges(data: DataSet, visits: list[Visit], events: tuple[Upheaval, ...]) -> list[_Edge]:
    """What is tied to what: visits (by number), places of cameras, and the map."""
    lifts = [event for event in events if isinstance(event, Lift)]
    edges: list[_Edge] = []
    last: dict[str, int] = {}
    for number, visit in enumerate(visits):
        edges.append((number, _place(events, visit.camera, visit.first_ns)))
        before = last.get(visit.robot)
        is_lifted = before is not None and any(
            lift.robot == visit.robot
            and visits[before].first_ns <= lift.after_ns < lift.before_ns <= visit.first_ns
            for lift in lifts
        )
        if before is not None and not is_lifted:
            edges.append((before, number))
        elif before is None and visit.robot == data.anchored_robot:
            edges.append((number, _ROOT))
        last[visit.robot] = number
    edges += [(_ROOT, _place(events, camera, data.epoch_ns)) for camera in data.known.poses]
    return edges


def _place(events: tuple[Upheaval, ...], camera: str, moment_ns: int) -> Hashable:
    """A camera's place at a moment: how often it was moved before."""
    knocks = [event for event in events if isinstance(event, Knock) and event.camera == camera]
    return camera, sum(moment_ns >= knock.since_ns for knock in knocks)


def _reached(edges: list[_Edge], start: Hashable) -> set[Hashable]:
    beside: dict[Hashable, list[Hashable]] = defaultdict(list)
    for one, other in edges:
        beside[one].append(other)
        beside[other].append(one)
    reached, open_ = {start}, [start]
    while open_:
        for other in beside[open_.pop()]:
            if other not in reached:
                reached.add(other)
                open_.append(other)
    return reached
