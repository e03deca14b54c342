"""One world: all hypotheses that may explain a session, given its noise.

It searches the joint hypotheses. `verify` then holds the finished best one against its
alternatives: for each camera, where else could it be, given all the others?
"""

from collections.abc import Iterator, Mapping

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation

from .agreement import seen_by
from .events import Events, window
from .explanation import Place
from .graph import Break, Graph, Tie, Variant
from .hypothesis import Hypothesis
from .learning import SessionNoise
from .memory import Memory
from .modes import ModeFinder
from .noise import with_noise
from .search import Search
from .trail import Trail
from .visits import Visit, visits_of

# Explanations that are worse than the best by more have no share in where a camera is.
_COUNTS = 2 * window()
_Spot = tuple[str, int]
"""A robot's node, or a camera's place."""


class World:
    """All hypotheses that may explain the session under one model of its noise.

    `parts`: the visits as another world cut them; None: they are cut here. `undecided`: the cameras
    for which not all alternatives were searched: the budget was spent or, but in a draft, there
    were too many.
    """

    def __init__(
        self,
        data: DataSet,
        observations: list[Observation],
        events: Events,
        noise: SessionNoise,
        memory: Memory,
        parts: list[Visit] | None = None,
        *,
        is_draft: bool = False,
    ) -> None:
        self.observations, self.noise, self.events = observations, noise, events
        self.data = data = with_noise(data, noise.by_robot)
        self.finder = finder = ModeFinder(data, observations, events, memory)
        if parts is None:
            found = [part for v in visits_of(data, observations) for part in finder.parts_of(v)]
        else:
            found = [finder.modes_of(visit) for visit in parts]
        self.visits = sorted(found, key=lambda part: (part.visit.stamp_ns, part.visit.camera))
        keys = [(finder.key(v.visit), *data.told, *data.known.poses) for v in self.visits]
        self._known = max(memory.trails, key=lambda trail: trail.same(keys), default=None)
        shown = self._known.shown if self._known is not None else {}
        self.graph = Graph(data, self.visits, events, keys, shown)
        self.budget = memory.budget
        self.search = Search(self.graph, events, self.budget, is_draft=is_draft)
        self.trail = Trail(self.graph, keys)
        self.hypotheses = self._searched(self._known)
        self.undecided = self._cameras() if self.search.is_given_up else set()

    @property
    def score(self) -> float:
        """The score of the best hypothesis with that of the noise."""
        return self.hypotheses[0].score + self.noise.score

    def verify(self) -> None:
        """Add the alternatives to the best hypothesis that the search alone may have pruned."""
        self._doubt_events()
        if self.search.is_given_up:
            self.undecided = self._cameras()
        else:
            self._verify_cameras()

    def _cameras(self) -> set[str]:
        return {v.visit.camera for v in self.visits}

    def _settled_cameras(self) -> set[str]:
        """The cameras that the past knows and that all their visits tie to where it does, in the
        best explanation; and those that the search before this one verified and that were not seen
        since, where all that came is as its best explanation has it. Where else these could be was
        asked then; that they were moved since, or a robot was lifted, this search asks at each
        visit."""
        past, best = self.data.past, self.hypotheses[0]
        settled = set(past.known.poses) if past is not None else set[str]()
        settled -= {
            v.visit.camera
            for number, v in enumerate(self.visits)
            if number not in best.ties or best.ties[number].place
        }
        if self._known is not None and self._goes_on(best):
            new = self.visits[len(self._known.keys) :]
            settled |= self._known.verified - {v.visit.camera for v in new}
        return settled

    def _goes_on(self, best: Hypothesis) -> bool:
        """Whether the best explanation only adds visits to that of the search before this one, and
        nothing happened at any of these."""
        assert self._known is not None
        before = self._known.best
        return (
            self._known.same(self.trail.keys) == len(self._known.keys)
            and (best.nothing, best.breaks) == (before.nothing, before.breaks)
            and all(best.ties.get(n) == tie for n, tie in before.ties.items())
            and all(best.place_of(n) == place for n, place in before.open.items())
            and self.search.happened(best) == self.search.happened(before)
        )

    def _searched(self, known: Trail | None, *, wrong: int | None = None) -> list[Hypothesis]:
        """Search the explanations of all visits, from where the search that left the trail `known`
        was the same, and leave the trail of this world; where one visit is taken to be `wrong`,
        leave none."""
        count, starts, self.search.is_cut = 0, list[Hypothesis](), False
        if known is not None and not self.budget.is_spent:
            same = known.same(self.trail.keys)
            count, kept = known.before(self.graph, same if wrong is None else wrong)
            starts = self.search.placed(kept)
            if wrong is None:
                self.trail.take_over(known, count)
        if not starts:
            count, starts = 0, [self.search.beginning()]
        numbers = range(count, len(self.visits))
        return self.search.explained(starts, numbers, wrong=wrong, trail=self.trail)

    def _doubt_events(self) -> None:
        """Add alternatives to each event of the best explanation: the lift in another gap, and the
        session with the visit that shows the event first taken as wrong. The search alone prunes
        these, since it meets what an event costs later too late."""
        doubted = set[int]()
        while not self.search.is_given_up:
            self._add(self.search.lifted_elsewhere(self.hypotheses[0]))
            doubts = set(self.hypotheses[0].first_after_events(self.graph)) - doubted
            if not doubts:
                break
            number = min(doubts)
            doubted.add(number)
            self._add(self._searched(self.trail, wrong=number))

    def _add(self, found: list[Hypothesis]) -> None:
        """Add those of these hypotheses that are new, keeping all that count sorted by score: each
        holds a solved graph, and those of all cameras together would fill the memory."""
        known = {_signature(hypothesis) for hypothesis in self.hypotheses}
        every = self.hypotheses + [each for each in found if _signature(each) not in known]
        every.sort(key=lambda hypothesis: hypothesis.score)
        self.hypotheses = [each for each in every if each.score <= every[0].score + _COUNTS]

    def _verify_cameras(self) -> None:
        """For each camera of the best explanation that is not settled, search everything else that
        its visits may be: too much, and it is undecided. If the budget does not suffice, all
        cameras not verified yet are undecided, those with only one visit included."""
        best, near = self.hypotheses[0], self.hypotheses[0].score + _COUNTS
        likeliest, verified = _signature(best), self._settled_cameras()
        settled = set(verified)
        cameras = dict.fromkeys(v.visit.camera for v in self.visits)
        for camera in [name for name in cameras if name not in verified]:
            mine = [n for n, v in enumerate(self.visits) if v.visit.camera == camera]
            if len(mine) < 2:
                continue
            rest = self._without(best, set(mine))
            if rest is None:
                continue
            self.search.is_cut = False
            found = self.search.explained([rest], mine)
            if self.search.is_cut:
                self.undecided.add(camera)
            elif {_signature(h) for h in found if h.score <= near} == {likeliest}:
                settled.add(camera)
            if self.budget.is_spent:
                self.undecided |= cameras.keys() - verified
                break
            verified.add(camera)
            self._add(found)
        if self.hypotheses[0] is best and not self.search.is_draft:
            self.trail.conclude(best, settled)

    def _without(self, hypothesis: Hypothesis, numbers: set[int]) -> Hypothesis | None:
        """The explanation of all visits but these; None where that is not determined."""
        ties = {n: tie for n, tie in hypothesis.ties.items() if n not in numbers}
        rest = replace(
            hypothesis,
            open={n: place for n, place in hypothesis.open.items() if n not in numbers},
            nothing=hypothesis.nothing - numbers,
        )
        variant = Variant(ties, rest.nothing, rest.breaks, hypothesis.placed)
        found = self.search.placed([(rest, variant)])
        return found[0] if found else None

    def loose(self) -> list[tuple[float, set[str]]]:
        """For each explanation with an event: its score, and the cameras whose last places would
        be elsewhere if the robot had been carried once more, unseen."""
        found = []
        for hypothesis in self.hypotheses:
            if hypothesis.score > self.hypotheses[0].score + window():
                break
            if not self.search.happened(hypothesis):
                continue
            tied = tied_twice(self.graph, hypothesis.ties, hypothesis.open, hypothesis.breaks)
            last: dict[str, int] = {}
            for number, place in hypothesis.places.items():
                camera = self.visits[number].visit.camera
                last[camera] = max(last.get(camera, 0), place)
            loose = {camera for camera, place in last.items() if (camera, place) not in tied}
            found.append((hypothesis.score + self.noise.score, loose))
        return found

    def places(self, camera: str, number: int | None) -> list[Place]:
        """Where each explanation puts a camera. `number`: which of its places; None: the last."""
        found = []
        for hypothesis in self.hypotheses:
            if hypothesis.score > self.hypotheses[0].score + _COUNTS:
                break
            found += self._places_by(hypothesis, camera, number)
        return found

    def _places_by(self, hypothesis: Hypothesis, camera: str, number: int | None) -> list[Place]:
        assert hypothesis.placed is not None
        score = hypothesis.score + self.noise.score
        mine = {
            n: place
            for n, place in hypothesis.places.items()
            if self.visits[n].visit.camera == camera
        }
        wanted = max(mine.values(), default=0) if number is None else number
        there = [n for n, place in mine.items() if place == wanted]
        if not there:
            return []
        placed = hypothesis.placed
        if there[0] in hypothesis.ties:
            key = camera, wanted
            covariance = placed.covariance(placed.layout.places[key])
            return [Place(placed.place(key), covariance, score)]
        seen = seen_by(self.graph, placed, there[0])
        shared = placed.covariance(seen.rows)
        covariance = seen.by_unknowns @ shared @ np.swapaxes(seen.by_unknowns, 1, 2) + seen.own
        evidences = self.graph.modes[there[0]].evidence
        least = float(evidences.min())
        return [
            Place(seen.pose[mode], covariance[mode], score + float(evidence) - least)
            for mode, evidence in enumerate(evidences)
        ]


def _signature(hypothesis: Hypothesis) -> tuple[object, ...]:
    return (
        tuple(sorted((n, t.mode, t.place) for n, t in hypothesis.ties.items())),
        tuple(sorted(hypothesis.open.items())),
        hypothesis.nothing,
        hypothesis.breaks,
    )


def tied_twice(
    graph: Graph, ties: Mapping[int, Tie], opened: Mapping[int, int], breaks: frozenset[Break]
) -> set[_Spot]:
    """Return the places (camera, number) that stay connected to the map's origin even if a robot
    was carried in any single gap between visits.

    A lift in a gap that only odometry bridges cannot be detected, since no other tie closes a loop
    around it. In a session in which nothing happened it is too improbable to matter; where a robot
    was carried or a camera was moved once, it is not (`Events.event_score`), and what lies beyond
    may be anywhere.

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
