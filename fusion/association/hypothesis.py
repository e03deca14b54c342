"""One explanation of the visits so far."""

from msgspec import Struct, field

from .graph import Break, Graph, Place, Placed, Tie, Variant


class Hypothesis(Struct, frozen=True):
    """One explanation of the visits so far.

    `ties`: by number, the visits that tie a robot to a place in the graph; `open`: by number, the
    other visits that are right, each the only one to its place, and that place; `nothing`: the
    visits all of whose sightings are wrong; `breaks`: the lifts; `placed`: the graph at its
    minimum; `score`: of the whole explanation; `is_stale`: `placed` still uses the motion of a
    robot as shown by a visit that has since been taken to be wrong.
    """

    ties: dict[int, Tie] = field(default_factory=dict)
    open: dict[int, int] = field(default_factory=dict)
    nothing: frozenset[int] = frozenset()
    breaks: frozenset[Break] = frozenset()
    placed: Placed | None = None
    score: float = 0.0
    is_stale: bool = False

    def place_of(self, number: int) -> int | None:
        """Return the number of a visit's place; None if its sightings are wrong."""
        if number in self.ties:
            return self.ties[number].place
        return self.open.get(number)

    @property
    def places(self) -> dict[int, int]:
        """By number, the place of each visit that is right."""
        return {n: tie.place for n, tie in self.ties.items()} | self.open

    @property
    def later_places(self) -> list[tuple[int, int]]:
        """The number of each visit that is right after its camera was moved, and its place: hardly
        any of them all."""
        tied = [(n, tie.place) for n, tie in self.ties.items() if tie.place]
        return tied + [(n, place) for n, place in self.open.items() if place]

    @property
    def happening(self) -> object:
        """What happened: the visits' places, which visits are wrong, and which robots were lifted.
        Modes and gaps do not count, since other gaps are tried in the end."""
        lifted = sorted(robot for robot, _ in self.breaks)
        return tuple(sorted(self.places.items())), self.nothing, tuple(lifted)

    def variant(self, breaks: frozenset[Break]) -> Variant:
        """Return the graph of this hypothesis with these breaks, yet to be solved."""
        return Variant(self.ties, self.nothing, breaks, self.placed)

    def first_after_events(self, graph: Graph) -> list[int]:
        """Return the numbers of the visits that are the first after an event: of a robot after it
        was lifted, or of a camera after it was moved."""
        lifts: dict[Break, int] = {}
        moves: dict[Place, int] = {}
        for number in sorted([*self.ties, *self.open]):
            visit, node = graph.visits[number].visit, graph.node_of[number]
            for robot, gap in self.breaks:
                if robot == visit.robot and node > gap:
                    lifts.setdefault((robot, gap), number)
            if place := self.place_of(number):
                moves.setdefault((visit.camera, place), number)
        return sorted({*lifts.values(), *moves.values()})
