"""Where one robot is in a fixed map.

A sighting may be wrong, its camera may have been moved since the map was made, and the robot may be
lifted; one face may look the same from several places. All of that are hypotheses about where the
robot is, compared by one score: wrong sightings cost as `[fusion.priors]` says, but all those of
one camera together no more than that it was moved, and a place that begins elsewhere costs as
much as a lift. Corrections come from the only hypothesis that is left within the level of evidence.
"""

from collections import Counter

from numpy.linalg import LinAlgError

from trigpoint.fusion.association.events import window
from trigpoint.fusion.estimators.interface import Update
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.known_cameras import KnownCameras
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.solver.filter import RobotEstimate, is_placed
from trigpoint.geometry.rotation import Array

from .hypothesis import Account, Costs, Hypothesis, accounts_after, begun
from .network import FixedNetwork

# As many as a target of six faces alike, each read from either end, may begin with at once.
_MOST = 16


class Placing:
    """One robot's hypotheses. Not thread-safe."""

    def __init__(self, data: DataSet, fixed: FixedNetwork, robot: str) -> None:
        self._data, self._fixed, self._robot = data, fixed, robot
        self._costs = Costs.of(data)
        self._found: list[Hypothesis] = []
        self._is_established = False

    @property
    def _best(self) -> Hypothesis | None:
        return min(self._found, key=lambda each: each.score, default=None)

    @property
    def contradicted_by(self) -> list[str]:
        """The cameras that see the robot elsewhere than the others do."""
        best = self._best
        return best.contradicted_by if best is not None else []

    def estimate(self) -> RobotEstimate | None:
        """The robot at its last odometry message; None while its place is not known."""
        best = self._best
        if best is None or not self._is_established:
            return None
        estimate = best.current.robot(self._robot)
        return estimate if estimate is not None and is_placed(estimate.covariance) else None

    def take(self, observation: Observation, cameras: KnownCameras) -> Update:
        """Place the robot by a sighting of one of the map's cameras; `cameras`: as uncertain as
        they are now. Of a sighting that contradicts the robot's place no more is said than that."""
        self._drop_lost(observation.stamp_ns)
        if observation.is_repeat:
            return Update(self._tried(observation))
        verdicts, corrections = {}, {}
        for each in self._found:
            try:
                verdicts[each], corrections[each] = each.use(observation)
            except (LinAlgError, ValueError) as reason:
                camera = observation.camera
                return Update(problem=f"a sighting of {camera} is unusable ({reason})")
        best = self._best
        contradicts = best is not None and verdicts[best] is Verdict.REJECTED
        if not self._found or set(verdicts.values()) == {Verdict.REJECTED}:
            self._begin(observation, cameras)
        self._prune()
        only = self._only
        correction = corrections.get(only) if only is not None else None
        return Update(correction, contradiction="" if contradicts else None)

    @property
    def _only(self) -> Hypothesis | None:
        """The hypothesis beside which no other one is possible; None where there is none."""
        return self._found[0] if self._is_established and len(self._found) == 1 else None

    def _tried(self, observation: Observation) -> RobotEstimate | None:
        only = self._only
        return only.current.tried(Entry(observation)) if only is not None else None

    def _drop_lost(self, stamp_ns: int) -> None:
        self._found = [
            each for each in self._found if not each.is_lost(self._data, self._robot, stamp_ns)
        ]
        self._is_established &= bool(self._found)

    def _begin(self, observation: Observation, cameras: KnownCameras) -> None:
        """Add every place that this sighting allows, which no hypothesis explains."""
        state = self._fixed.states[observation.camera]
        time_ns = int(self._data.true_times_ns(state, observation.stamp_ns))
        track = self._data.tracks[self._robot]
        if not track.covers(time_ns):
            return
        scales = self._fixed.scales(self._robot)
        seen = self._data.moving(observation, time_ns, scales)
        parent = self._best
        for current in begun(
            self._data, self._fixed.states, cameras.covariance, seen, time_ns, scales
        ):
            accounts = [Account(self._costs)]
            if parent is not None:
                accounts = accounts_after(parent, observation.camera)
            agreeing = Counter({observation.camera: 1})
            self._found.append(Hypothesis(current, self._costs, accounts, agreeing))

    def _prune(self) -> None:
        """Keep the best ones that are possible, one for each place."""
        kept: list[Hypothesis] = []
        for each in sorted(self._found, key=lambda one: one.score):
            if kept and each.score - kept[0].score >= window():
                break
            if not any(each.is_where(other, self._robot) for other in kept):
                kept.append(each)
        self._found = kept[:_MOST]
        if len(kept) == 1:
            kept[0].settle()
            self._is_established |= kept[0].support >= window()

    # -- as time passes ---------------------------------------------------------------------------

    def forget_before(self, stamp_ns: int) -> None:
        """Carry the robot on to a moment, before which its odometry is not needed any more."""
        for each in self._found:
            each.current.forget_before(self._robot, stamp_ns)

    def widen(self, crept: dict[str, Array]) -> None:
        """Let the cameras creep on by covariances (6, 6)."""
        for each in self._found:
            each.current.spread(crept)
