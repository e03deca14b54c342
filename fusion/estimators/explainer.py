"""Collects what an estimator took in, and decides when the association explains all of it anew.

An estimator uses at once what it can interpret. What it cannot, such as a camera that is not
located or a robot that is not where it was, it leaves to the association. To keep that a small
share of the work, the association is asked once half as many such sightings have come as it left
unexplained the last time, or a fifth as many in all.
"""

from collections import Counter
from collections.abc import Container

from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.explanation import Alternative, CameraFinding, Explanation
from trigpoint.fusion.association.memory import Memory
from trigpoint.fusion.association.scales import with_solved_scales
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.geometry.rotation import Array

_GROWTH, _LEAST_NEW = 1.2, 20
# For a camera and a robot: the sightings that are unexplained amount to half of those left before,
# and to a third of those that came since.
_OPEN_GROWTH, _OPEN_SHARE, _LEAST_OPEN = 0.5, 1 / 3, 3

_BEHIND_A_JUMP = (
    "position and orientation in the map: the robot's odometry jumped on its way here from the "
    "other cameras; drive there without a break"
)

_FEW = "too few pictures of the robot so far"
_FORGOTTEN = (
    "position and orientation: its sightings did not decide where it is, and are too old to be "
    "kept; drive past it"
)

_Pair = tuple[str, str]


class Explainer:
    """The observations so far, and their last explanation. Not thread-safe."""

    def __init__(self, data: DataSet) -> None:
        self._data = data
        self._memory = Memory()
        self._observations: list[Observation] = []
        self._undecided: frozenset[str] = frozenset()
        self.explanation: Explanation | None = None
        self._is_told = False
        # How many observations the last explanation covers, and what it left unexplained; what has
        # come since, and what of that is unexplained.
        self._explained = 0
        self._left: Counter[_Pair] = Counter()
        self._came: Counter[_Pair] = Counter()
        self._open: Counter[_Pair] = Counter()

    def take(self, observation: Observation, *, is_used: bool) -> None:
        """Note an observation as it came, and whether the estimator could use it."""
        pair = observation.camera, observation.robot
        self._observations.append(observation)
        self._came[pair] += 1
        self._open[pair] += not is_used

    def leave_open(self, cameras: frozenset[str]) -> None:
        """See `Live.leave_open`."""
        if cameras != self._undecided and self._observations:
            self._undecided, self._explained = cameras, -1

    def forget_past(self) -> None:
        """Drop the observations that are part of the past now; what is left is to be explained."""
        self._observations = [each for each in self._observations if not self._data.is_past(each)]
        self._memory.keep(self._observations)
        self._explained = -1

    def camera_moved(self) -> None:
        """Note that the data tell of another move of a camera."""
        self._is_told = True

    @property
    def has_new(self) -> bool:
        """Whether anything that matters came since the last explanation."""
        return len(self._observations) > self._explained or self._is_told

    @property
    def is_due(self) -> bool:
        """Whether everything is to be explained anew."""
        has_grown = len(self._observations) >= _GROWTH * self._explained + _LEAST_NEW
        return has_grown or self.has_unexplained or self._is_told

    @property
    def has_unexplained(self) -> bool:
        """Whether much came that is not explained."""
        return any(
            count >= max(_LEAST_OPEN, _OPEN_SHARE * self._came[p], _OPEN_GROWTH * self._left[p])
            for p, count in self._open.items()
        )

    def explain(
        self, scales: dict[str, tuple[Array, Array]] | None = None, *, is_draft: bool = False
    ) -> Explanation:
        """Explain everything that came. `scales`: by robot the odometry's scale errors (2,) and
        their sigmas (2,) from a solution, of use where little is known of them beforehand;
        `is_draft`: only the likeliest explanation, from which the scales are estimated."""
        self._observations.sort(key=lambda observation: observation.stamp_ns)
        self._explained, self._is_told = len(self._observations), False
        self._came, self._open = Counter(), Counter()
        draft = with_solved_scales(self._data.draft(), self._data, scales or {})
        self.explanation = explain(
            draft,
            list(self._observations),
            memory=self._memory,
            undecided=self._undecided,
            is_draft=is_draft,
        )
        return self.explanation

    def note(self, entries: list[Entry]) -> None:
        """Note which of all entries an explanation left unexplained."""
        unused = [e.observation for e in entries if e.observation.verdict is not Verdict.ACCEPTED]
        self._left = Counter((self._data.site_camera(o.camera), o.robot) for o in unused)

    def _finding(self, camera: str) -> CameraFinding | None:
        """What the last explanation says of a camera."""
        return self.explanation.findings.get(camera) if self.explanation is not None else None

    def undetermined(self, placed: Container[str]) -> dict[str, tuple[str, ...]]:
        """What is not known of each camera that saw a robot and is not among those placed."""
        return {
            name: (self._reason(name) or _BEHIND_A_JUMP,)
            for name in self._data.site.cameras
            if name not in placed and self._was_seen(name)
        }

    def _was_seen(self, camera: str) -> bool:
        is_recent = any(self._data.of_camera(place) for place in self._data.places_of(camera))
        return is_recent or self._data.past_of(camera).sightings > 0

    def _reason(self, camera: str) -> str:
        """Why a camera that was seen is not located; "" where the explanation does not say."""
        finding = self._finding(camera)
        if finding is not None:
            return finding.reason
        return _FORGOTTEN if self._data.past_of(camera).sightings else _FEW

    def alternatives(self, camera: str) -> tuple[Alternative, ...]:
        """The possible poses of a camera that is not located, best first."""
        finding = self._finding(camera)
        return finding.alternatives if finding is not None and not finding.is_located else ()
