"""The outcome of each sighting that a filter processed, and those that contradict the rest."""

from msgspec import Struct

from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Verdict
from trigpoint.geometry import Pose

from .filter_state import FilterState, Innovation

# With one wrong reading in twenty, so many in a row occur once in 160,000 times.
_IN_A_ROW = 4


class Step(Struct):
    """The outcome of one sighting. `before`: the filter state before it, None where that is too
    long ago; `map_from_base`: afterwards; `innovation`: None where it was set aside."""

    time_ns: int
    entry: int
    before: FilterState | None
    map_from_base: Pose | None
    innovation: Innovation | None


class Contradiction(Struct, frozen=True):
    """Consecutive sightings by one camera or of one robot, `what`, all of which contradict the
    filter state, which noise or a single wrong reading does not explain."""

    what: str
    since_ns: int
    until_ns: int

    @property
    def text(self) -> str:
        """The report to the user."""
        return (
            f"{_IN_A_ROW} pictures or more in a row {self.what} contradict the rest: a robot was "
            "carried, a camera was moved, or the filter went wrong and with it the cameras that it "
            'located meanwhile; run the session with estimator = "smoother"'
        )


def contradictions(data: DataSet, steps: list[Step]) -> list[Contradiction]:
    """The contradictions among the steps, in order of their ends."""
    found: list[Contradiction] = []
    runs: dict[str, list[int]] = {}
    for step in steps:
        observation = data.entries[step.entry].observation
        for what in (f"by camera {observation.camera}", f"of robot {observation.robot}"):
            if observation.verdict is Verdict.REJECTED:
                runs.setdefault(what, []).append(observation.stamp_ns)
            elif what in runs:
                found += _told({what: runs.pop(what)})
    return found + _told(runs)


def _told(runs: dict[str, list[int]]) -> list[Contradiction]:
    return [
        Contradiction(what, stamps_ns[0], stamps_ns[-1])
        for what, stamps_ns in runs.items()
        if len(stamps_ns) >= _IN_A_ROW
    ]
