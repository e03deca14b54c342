"""The search for what explains a session: joint hypotheses, pruned by their score.

Visits are added in order of time. The first visit of a camera constrains nothing else, so it is
left `open` and costs no branch; at the next one every pair of modes that agree becomes a
hypothesis. The alternatives are that the visit's sightings are wrong and that the camera was moved;
where no pair agrees well, also that the robot was lifted in one of the gaps before.
"""

import math
from collections.abc import Iterable
from itertools import islice, pairwise, product
from weakref import WeakKeyDictionary

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from .agreement import agreement
from .budget import Budget
from .events import Events, log_sum, window
from .graph import Factor, Graph, Place, Placed, Tie, Variant
from .hypothesis import Hypothesis
from .minimum import Minima
from .told_moves import ToldMoves, of_camera
from .trail import Trail

# A partial explanation may win back what its score has lost so far, and no window bounds how much.
# So the hypotheses within the window are kept, and of those behind it a few of the best that differ
# in what happened.
_WINDOW = 2 * window()
_FAR_WINDOW = 6 * window()
_MOST_HYPOTHESES = 128
_MOST_FAR = 4
_MOST_BREAKS = 3
_MOST_PAIRS = 24


class _Join(Struct, frozen=True):
    """A visit that may be tied to a place that its camera already has. `before`: the hypothesis
    without that visit; `there`: the visits to this place so far."""

    before: Hypothesis
    number: int
    place: int
    there: tuple[int, ...]


# The mode of the only visit to a place so far (None: the graph has the place already), and that of
# the new visit.
_Pair = tuple[int | None, int]
# A place of the graph or, where it is open, the number of the only visit to it.
_Spot = int | Place


class Search:
    """Searches the explanations of the visits of one graph. `is_cut`: whether hypotheses were
    dropped for their number alone although their scores were within `window()` of the best that is
    known of the same visits; a draft does not ask. Once that is so, or the budget is spent, a
    search decides nothing, and the visits that are left are taken to be wrong."""

    def __init__(
        self, graph: Graph, events: Events, budget: Budget, *, is_draft: bool = False
    ) -> None:
        self.graph, self.events, self.budget, self.is_draft = graph, events, budget, is_draft
        self.visits, self.is_cut = graph.visits, False
        self.told = ToldMoves(graph)
        self._graphs = Minima(graph)
        # By graph, which many hypotheses that grow from one share: `_apart`.
        self._likelihoods = WeakKeyDictionary[Factor, dict[object, float]]()
        self._open_score = [
            log_sum(modes.evidence.tolist()) + events.pose_score for modes in graph.modes
        ]
        self._shows_one_picture = [visit.is_one_picture for visit in graph.visits]

    @property
    def is_given_up(self) -> bool:
        return self.is_cut or self.budget.is_spent

    def explained(
        self,
        starts: list[Hypothesis],
        numbers: Iterable[int],
        *,
        wrong: int | None = None,
        trail: Trail | None = None,
    ) -> list[Hypothesis]:
        """Return the hypotheses that add these visits to one of `starts`, pruned after each visit,
        best first. `trail`: where what is kept after each visit is noted; `wrong`: the visit all of
        whose sightings are taken to be wrong: then nothing is noted, and what is far behind the
        search that left the trail is dropped too."""
        hypotheses = starts
        for number in numbers:
            if number == wrong:
                grown = [self._wrong(before, number) for before in hypotheses]
            else:
                grown = self._with(hypotheses, number)
            known = np.inf if trail is None or wrong is None else trail.least(number + 1)
            hypotheses = self._pruned(grown, known)
            if not hypotheses:
                return []
            if trail is not None and wrong is None and not self.is_given_up:
                trail.note(number + 1, hypotheses)
        return hypotheses

    def beginning(self) -> Hypothesis:
        """Return the hypothesis that explains no visit yet."""
        (start,) = self.placed([(Hypothesis(), Variant({}, frozenset(), frozenset()))])
        return start

    def placed(self, wanted: Iterable[tuple[Hypothesis, Variant]]) -> list[Hypothesis]:
        """Return each hypothesis with the ties and breaks of its variant, its graph solved and
        scored; those whose graph is not determined are left out."""
        found: list[Hypothesis] = []
        for like, variant in wanted:
            placed, ties = self._minimum(variant), dict(variant.ties)
            if placed is not None:
                there = replace(
                    like, ties=ties, breaks=variant.breaks, placed=placed, is_stale=False
                )
                found.append(self.scored(there))
        return found

    def _minimum(self, variant: Variant) -> Placed | None:
        found = self._graphs.placed(variant)
        self.budget.spend_placing(unknowns=found.layout.size if found else 0)
        return found

    def scored(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return the hypothesis with its score computed from its graph and all else in it."""
        assert hypothesis.placed is not None
        score = hypothesis.placed.score
        score += sum(self._open_score[number] for number in hypothesis.open)
        score += sum(self._wrong_score(hypothesis, number) for number in hypothesis.nothing)
        score += self.events.happened(self.happened(hypothesis))
        score += sum(
            self._moved_score(hypothesis, earlier, later)
            for places in self._places(hypothesis).values()
            for earlier, later in pairwise(places)
        )
        return replace(hypothesis, score=score)

    def _places(self, hypothesis: Hypothesis) -> dict[str, list[_Spot]]:
        """Return, for each camera that was moved, its places in order of time."""
        assert hypothesis.placed is not None
        places: dict[Place, _Spot] = {place: place for place in hypothesis.placed.layout.places}
        for number, place in hypothesis.open.items():
            places[self.visits[number].visit.camera, place] = number
        found: dict[str, list[_Spot]] = {}
        for camera, _ in sorted(place for place in places if place[1] > 0):
            found[camera] = [places[key] for key in sorted(places) if key[0] == camera]
        return found

    def _moved_score(self, hypothesis: Hypothesis, earlier: _Spot, later: _Spot) -> float:
        """Return the score of a camera's move from one of its places to the next, which may have
        been only a push (`Events.moved`)."""
        apart = self._apart(hypothesis, earlier, later, is_pushed=True)
        apart -= sum(self._seen_score(each) for each in (earlier, later))
        return self.events.moved(apart)

    def _wrong_score(self, hypothesis: Hypothesis, number: int) -> float:
        """Return the score of a visit that is wrong. A single picture shows its board, as often as
        anywhere, near where it would have to be, as near as a camera is that was pushed. To bound
        the search, only where that is likelier than that it is right."""
        nothing, place = self.visits[number].nothing, self._place_about(hypothesis, number)
        if place is None:
            return nothing
        near = self._apart(hypothesis, place, number, is_pushed=True) + self.events.wrong_score
        if near > self._apart(hypothesis, place, number, is_pushed=False):
            return nothing
        near -= self._seen_score(place)
        return -2 * (float(np.logaddexp(-0.5 * nothing, -0.5 * near)) - math.log(2))

    def _seen_score(self, place: _Spot) -> float:
        """Return what the visit to an open place counts for already."""
        return self._open_score[place] - self.events.pose_score if isinstance(place, int) else 0.0

    def _place_about(self, hypothesis: Hypothesis, number: int) -> _Spot | None:
        """Return where a camera was as a visit of a single picture was wrong: its place before, or
        after; None where there is none."""
        if not (self._shows_one_picture[number] and self.visits[number].modes):
            return None
        camera = self.visits[number].visit.camera
        mine = of_camera(hypothesis, self.visits, camera)
        if camera in self.graph.data.known.poses and not (mine and mine[0] < number):
            return camera, 0
        if not mine:
            return None
        nearest = max([n for n in mine if n < number] or mine[:1])
        return nearest if nearest in hypothesis.open else (camera, hypothesis.places[nearest])

    def _apart(self, hypothesis: Hypothesis, one: _Spot, other: _Spot, *, is_pushed: bool) -> float:
        """Return -2 ln of the likelihood that two places of a camera are one, or a push apart, with
        the evidence of the visits among them."""
        placed = hypothesis.placed
        assert placed is not None
        known, key = self._likelihoods.setdefault(placed.factor, {}), (one, other, is_pushed)
        if key not in known:
            cost = agreement(self.graph, placed, one, other, is_pushed * self.events.push)
            known[key] = log_sum(cost.reshape(-1).tolist())
        return known[key]

    def happened(self, hypothesis: Hypothesis) -> int:
        """Return the number of lifts and moves in a hypothesis, but for moves that were told."""
        last: dict[str, int] = {}
        for number, place in hypothesis.later_places:
            camera = self.visits[number].visit.camera
            last[camera] = max(last.get(camera, 0), place)
        return len(hypothesis.breaks) + sum(last.values()) - self.told.count_in(hypothesis)

    def lifted_elsewhere(self, hypothesis: Hypothesis) -> list[Hypothesis]:
        """Return the alternatives to a hypothesis in which one of its lifts is in another gap of
        the robot's path, for each lift and each such gap."""
        wanted = [
            (hypothesis, hypothesis.variant(hypothesis.breaks - {(robot, gap)} | {other}))
            for robot, gap in hypothesis.breaks
            for step in range(len(self.graph.paths[robot].stamps_ns) - 1)
            if (other := (robot, step)) not in hypothesis.breaks
        ]
        return self.placed(wanted)

    def _pruned(self, grown: list[Hypothesis], known: float) -> list[Hypothesis]:
        """Return the hypotheses that are kept, best first. `known`: the score of one over the same
        visits."""
        least = min(known, *(hypothesis.score for hypothesis in grown))
        grown = [
            self._fresh(each) if each.is_stale else each
            for each in grown
            if each.score < least + _FAR_WINDOW
        ]
        grown.sort(key=lambda hypothesis: hypothesis.score)
        best = grown[0].score if grown else known
        near = [h for h in grown if h.score < best + _WINDOW]
        far: dict[object, Hypothesis] = {}
        for hypothesis in grown[len(near) :]:
            if hypothesis.score < best + _FAR_WINDOW:
                far.setdefault(hypothesis.happening, hypothesis)
        dropped = near[_MOST_HYPOTHESES:]
        if dropped and not self.is_draft:
            self.is_cut |= dropped[0].score < min(known, best) + window()
        return near[:_MOST_HYPOTHESES] + list(far.values())[:_MOST_FAR]

    # -- one more visit ---------------------------------------------------------------------------

    def _with(self, hypotheses: list[Hypothesis], number: int) -> list[Hypothesis]:
        """Return all hypotheses that add one more visit to one of these; once the search is given
        up, only the first of these with the visit wrong."""
        if self.is_given_up:
            return [self._wrong(hypotheses[0], number)]
        found: list[Hypothesis] = []
        joins: list[_Join] = []
        for before in hypotheses:
            plain, join = self._beside(before, number)
            found += plain
            joins += [join] if join is not None else []
        lifted: list[Hypothesis] = []
        for join in joins:
            tied = self._tied(join)
            found += tied
            if self._may_be_lifted(join, tied):
                lifted += self._lifted(join)
        return found + lifted

    def _beside(self, before: Hypothesis, number: int) -> tuple[list[Hypothesis], _Join | None]:
        """Return the hypotheses in which a visit is not tied to a place seen before: it is wrong,
        it is its camera's first, its camera was moved, or the only visit to the camera's last place
        was wrong; and the join with that last place, None if there is none."""
        visit = self.visits[number]
        wrong = self._wrong(before, number)
        if not visit.modes or self.told.is_during(number):
            return [wrong], None
        mine = of_camera(before, self.visits, visit.visit.camera)
        if not mine and visit.visit.camera in self.graph.data.known.poses:
            moved = self.scored(replace(before, open=before.open | {number: 1}))
            is_told = self.told.is_between(None, number)
            return [wrong, moved], None if is_told else _Join(before, number, 0, ())
        if not mine:  # whether it is wrong matters only at the camera's next visit
            return [self.scored(replace(before, open=before.open | {number: 0}))], None
        place = max(p for p in (before.place_of(n) for n in mine) if p is not None)
        there = tuple(n for n in mine if before.place_of(n) == place)
        if self.told.is_between(max(there), number):
            return [wrong, *self._opened(before, number, place + 1)], None
        found = [wrong]
        if not any(self._still_sees(n, visit.visit.stamp_ns) for n in there):
            found += self._opened(before, number, place + 1)
        if len(there) == 1:
            found += self._opened(self._wrong(before, there[0]), number, place)
        return found, _Join(before, number, place, there)

    def _opened(self, before: Hypothesis, number: int, place: int) -> list[Hypothesis]:
        """Return the hypotheses in which a visit is the only one to its place. All places of a
        camera whose lens or clock is estimated share these unknowns: the visit and the camera's
        open ones are then tied in the graph, by each combination of their modes (at most
        `_MOST_PAIRS`)."""
        camera = self.visits[number].visit.camera
        others = of_camera(before, self.visits, camera)
        if camera not in self.graph.own_prior or not others:
            return [self.scored(replace(before, open=before.open | {number: place}))]
        alone = [n for n in others if n in before.open]
        left = replace(before, open={n: p for n, p in before.open.items() if n not in alone})
        places = {n: before.open[n] for n in alone} | {number: place}
        modes = [range(len(self.visits[n].modes)) for n in places]
        variants = []
        for chosen in islice(product(*modes), _MOST_PAIRS):
            ties = {n: Tie(m, places[n]) for n, m in zip(places, chosen, strict=True)}
            ties = before.ties | ties
            variants.append(Variant(ties, before.nothing, before.breaks, before.placed))
        return self.placed([(left, variant) for variant in variants])

    def _still_sees(self, number: int, stamp_ns: int) -> bool:
        """Return whether a visit has pictures after this moment that are right, so that its camera
        was not moved before."""
        return any(seen_ns > stamp_ns for seen_ns, _ in self.visits[number].right)

    def _wrong(self, before: Hypothesis, number: int) -> Hypothesis:
        """Return a hypothesis with all sightings of a visit wrong."""
        ties = {n: tie for n, tie in before.ties.items() if n != number}
        opened = {n: place for n, place in before.open.items() if n != number}
        after = replace(before, ties=ties, open=opened, nothing=before.nothing | {number})
        if number in before.ties:
            return self._fresh(after)
        return self.scored(replace(after, is_stale=self.graph.shows_steps(number)))

    def _fresh(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return a hypothesis with its graph solved anew, or as it was if that is not
        determined."""
        found = self.placed([(hypothesis, hypothesis.variant(hypothesis.breaks))])
        return found[0] if found else self.scored(replace(hypothesis, is_stale=False))

    def _tied(self, join: _Join) -> list[Hypothesis]:
        """Return a hypothesis by each pair of modes that agree."""
        return self.placed([self._joined(join, pair) for pair in self._pairs(join)])

    def _joined(self, join: _Join, pair: _Pair) -> tuple[Hypothesis, Variant]:
        """Return the hypothesis and the variant, yet to be solved, that tie a visit by this pair of
        modes."""
        before, (first, second) = join.before, pair
        ties = before.ties | {join.number: Tie(second, join.place)}
        if first is not None:
            ties = ties | {join.there[0]: Tie(first, join.place)}
        opened = {n: place for n, place in before.open.items() if n not in ties}
        variant = Variant(ties, before.nothing, before.breaks, before.placed)
        return replace(before, open=opened), variant

    # -- lifts ------------------------------------------------------------------------------------

    def _may_be_lifted(self, join: _Join, tied: list[Hypothesis]) -> bool:
        """Return whether a lift before a visit is to be tried: none of the `tied` hypotheses
        explains the visit well enough, and there are not too many breaks yet."""
        if len(join.before.breaks) >= _MOST_BREAKS:
            return False
        before, number = join.before, join.number
        count = self.happened(before)
        another = self.events.happened(count + 1) - self.events.happened(count)
        alternative = min(self.visits[number].nothing, self._open_score[number] + another)
        best = min((h.score - before.score for h in tied), default=np.inf)
        expected = self._open_score[number] - self.events.pose_score
        return not (best < expected + another or best < alternative - _WINDOW)

    def _lifted(self, join: _Join) -> list[Hypothesis]:
        """Return the hypotheses that tie a visit after a lift of its robot, in each of the gaps
        since the robot's first visit to the place. The pairs of modes are chosen with the lift in
        the last gap."""
        robot, before = self.visits[join.number].visit.robot, join.before
        gaps = [before.breaks | {(robot, gap)} for gap in self._gaps(join)]
        loose = self._minimum(before.variant(gaps[-1])) if gaps else None
        if loose is None:
            return []
        relaxed = replace(join, before=replace(before, placed=loose, breaks=gaps[-1]))
        tied = self._tied(relaxed)
        best = min((h.score for h in tied), default=np.inf)
        near = [h for h in tied if h.score < best + _WINDOW]
        return near + self.placed((h, h.variant(breaks)) for h in near for breaks in gaps[:-1])

    def _gaps(self, join: _Join) -> list[int]:
        """Return the nodes after which a robot may have been lifted: those since its first visit
        to the place, or since its first node if it has none."""
        robot = self.visits[join.number].visit.robot
        same = [n for n in join.there if self.visits[n].visit.robot == robot]
        first = self.graph.node_of[min(same)] if same else 0
        last = self.graph.node_of[join.number]
        return [g for g in range(first, last) if (robot, g) not in join.before.breaks]

    # -- which modes agree ------------------------------------------------------------------------

    def _pairs(self, join: _Join) -> list[_Pair]:
        """Return the pairs of modes that agree best: within the window of the best one, but all of
        a robot that was lifted, of whose heading since too little is known to judge so."""
        before, robot = join.before, self.visits[join.number].visit.robot
        assert before.placed is not None
        apart = np.inf if any(robot == lifted for lifted, _ in before.breaks) else _WINDOW
        is_open = bool(join.there) and join.there[0] in before.open
        first = join.there[0] if is_open else (self.visits[join.number].visit.camera, join.place)
        cost = agreement(self.graph, before.placed, first, join.number)
        order = np.argsort(cost, axis=None, kind="stable")[:_MOST_PAIRS]
        rows, columns = np.unravel_index(order, cost.shape)
        return [
            (int(row) if is_open else None, int(column))
            for row, column in zip(rows, columns, strict=True)
            if cost[row, column] < cost.min() + apart
        ]
