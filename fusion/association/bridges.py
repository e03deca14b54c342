"""Which places are connected to the map only by odometry across a single gap.

A lift in such a gap cannot be detected, since no other tie closes a loop around it. In a session in
which nothing happened it is too improbable to matter; where a robot was carried or a camera was
moved once, it is not (`Events.event_score`), and what lies beyond the gap may be anywhere.
"""

from collections.abc import Iterator, Mapping

from .graph import Break, Graph, Tie

_Spot = tuple[str, int]
"""A robot's node, or a camera's place."""


def tied_twice(
    graph: Graph, ties: Mapping[int, Tie], opened: Mapping[int, int], breaks: frozenset[Break]
) -> set[_Spot]:
    """Return the places (camera, number) that stay connected to the map's origin even if a robot
    was carried in any single gap between visits.

    `opened`: by number of a visit that is the only one to see its place, that place.
    """
    edges = [
        (robot, step)
        for robot, path in graph.paths.items()
        for step in range(len(path.stamps_ns) - 1)
        if (robot, step) not in breaks
    ]
    used = {**{n: tie.place for n, tie in ties.items()}, **opened}
    seen = {
        (graph.visits[n].visit.camera, place): (graph.visits[n].visit.robot, graph.node_of[n])
        for n, place in opened.items()
    }
    first = _first_seen(graph, used)
    found: set[_Spot] | None = None
    for cut in [None, *edges]:
        if cut is not None and (cut[1] < first.get(cut[0], 0) or graph.across(cut) is not None):
            continue  # before the robot's first visit, or a visit goes on across the gap
        reached = _reached(graph, ties, breaks | ({cut} if cut else set()), first)
        reached |= {place for place, node in seen.items() if node in reached}
        found = reached if found is None else found & reached
    return found or set()


def _first_seen(graph: Graph, used: Mapping[int, int]) -> dict[str, int]:
    """Return, by robot, the node of its first visit that is used."""
    found: dict[str, int] = {}
    for number in used:
        robot, node = graph.visits[number].visit.robot, graph.node_of[number]
        found[robot] = min(found.get(robot, node), node)
    return found


def _reached(
    graph: Graph, ties: Mapping[int, Tie], breaks: frozenset[Break], first: Mapping[str, int]
) -> set[_Spot]:
    """Return all nodes and places that are connected to the map's origin or to a known camera."""
    beside: dict[_Spot, list[_Spot]] = {}
    for one, other in _edges(graph, ties, breaks):
        beside.setdefault(one, []).append(other)
        beside.setdefault(other, []).append(one)
    waiting: list[_Spot] = [(camera, 0) for camera in graph.data.known.poses]
    waiting += [(r, first.get(r, 0)) for r, path in graph.paths.items() if path.is_anchored]
    reached = set(waiting)
    while waiting:
        for other in beside.get(waiting.pop(), []):
            if other not in reached:
                reached.add(other)
                waiting.append(other)
    return reached


def _edges(
    graph: Graph, ties: Mapping[int, Tie], breaks: frozenset[Break]
) -> Iterator[tuple[_Spot, _Spot]]:
    for robot, path in graph.paths.items():
        for step in range(len(path.stamps_ns) - 1):
            if (robot, step) not in breaks:
                yield (robot, step), (robot, step + 1)
    for number, tie in ties.items():
        visit = graph.visits[number].visit
        yield (visit.robot, graph.node_of[number]), (visit.camera, tie.place)
