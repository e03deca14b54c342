"""One place at which a robot may be in a fixed map, carried on by its odometry and sightings."""

from collections import Counter

import numpy as np
from msgspec import Struct, field
from numpy.linalg import LinAlgError

from trigpoint.fusion.association.events import Events
from trigpoint.fusion.estimators.robot_alignment import camera_sigma_px
from trigpoint.fusion.estimators.smoother.current_filter import EXCESS, CurrentFilter
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import is_noise
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.reading.alignment import PosePrior, align, placements
from trigpoint.fusion.solver.filter import Filter, RobotEstimate
from trigpoint.geometry import Pose
from trigpoint.geometry.chi_square import chi2_limit
from trigpoint.geometry.rotation import Array

# Two hypotheses whose poses differ by more are two places: as often as good sightings are gated.
_ELSEWHERE = 1e-5
# A pose of a single picture is told from the others that the picture allows by this prior, m, rad.
_NEAR = np.diag(np.repeat([0.1**2, 0.1**2], 3))


class Costs(Struct, frozen=True):
    """Scores of what may have happened, after `association.events`. `wrong`: a wrong sighting;
    `event`: a camera was moved, or the robot lifted, which explains any number of them."""

    wrong: float
    event: float

    @classmethod
    def of(cls, data: DataSet) -> "Costs":
        events = Events(data.site.fusion.priors)
        return cls(events.wrong_score, events.happened(1))

    def of_camera(self, count: int) -> float:
        """The score of so many sightings of one camera that are not explained otherwise."""
        return min(self.wrong * count, self.event)

    @property
    def most(self) -> int:
        """How many wrong sightings of a camera cost as much as that it was moved."""
        return int(np.ceil(self.event / self.wrong))


class Account(Struct):
    """One way in which a place may be right. `before`: the score of what must have happened then;
    `sunk`, `against`: by camera, how many sightings it does not explain, as far as they count: of
    before it was a hypothesis, and since, where sightings that it explains make up for others."""

    costs: Costs
    before: float = 0.0
    sunk: Counter[str] = field(default_factory=Counter[str])
    against: Counter[str] = field(default_factory=Counter[str])

    @property
    def unexplained(self) -> Counter[str]:
        """By camera, all that it does not explain."""
        return self.sunk + self.against

    @property
    def score(self) -> float:
        return self.before + sum(map(self.costs.of_camera, self.unexplained.values()))


class Hypothesis(Struct, eq=False):
    """`agreeing`: by camera, how many sightings it explains, as far as they count; `accounts`: the
    ways in which it may be right."""

    current: CurrentFilter
    costs: Costs
    accounts: list[Account]
    agreeing: Counter[str] = field(default_factory=Counter[str])

    @property
    def account(self) -> Account:
        """The likeliest one."""
        return min(self.accounts, key=lambda each: each.score)

    @property
    def score(self) -> float:
        """Minus twice the logarithm of its posterior, up to a constant."""
        return self.account.score

    @property
    def support(self) -> float:
        """By how much it is better than that all sightings which it explains are wrong."""
        return sum(map(self.costs.of_camera, self.agreeing.values()))

    @property
    def contradicted_by(self) -> list[str]:
        """The cameras that were moved if it is right."""
        unexplained = self.account.unexplained.items()
        return [name for name, count in unexplained if count >= self.costs.most]

    def use(self, observation: Observation) -> tuple[Verdict, RobotEstimate | None]:
        """Carry it on by a sighting; its verdict, PENDING where it came too late, and the robot
        then. Raises LinAlgError or ValueError where the sighting is unusable."""
        entry = Entry(observation)
        correction = self.current.use(entry)
        verdict, camera = entry.observation.verdict, observation.camera
        if verdict is Verdict.ACCEPTED:
            self._count(self.agreeing, camera, 1)
        for account in self.accounts:
            if verdict is Verdict.ACCEPTED:
                self._count(account.against, camera, -1)
            elif verdict is Verdict.REJECTED:
                self._count(account.against, camera, 1)
        return verdict, correction

    def _count(self, counts: Counter[str], camera: str, more: int) -> None:
        counts[camera] = min(max(counts[camera] + more, 0), self.costs.most)

    def settle(self) -> None:
        """Take it for right: no other one is possible."""
        known = self.account
        against = {name: min(n, self.costs.most) for name, n in known.unexplained.items()}
        self.accounts = [Account(self.costs, against=Counter(against))]

    def is_lost(self, data: DataSet, robot: str, stamp_ns: int) -> bool:
        """Whether odometry does not lead from it to a moment."""
        assert self.current.known is not None
        node_ns = self.current.known.stamps_ns[robot]
        pieces = data.tracks[robot].pieces(np.array([node_ns, max(node_ns, stamp_ns)]))
        return bool(pieces[0] != pieces[1])

    def is_where(self, other: "Hypothesis", robot: str) -> bool:
        """Whether it puts the robot where another one does."""
        mine, theirs = self.current.robot(robot), other.current.robot(robot)
        assert mine is not None
        assert theirs is not None
        tangent = self.current.data.tracks[robot].tangent
        apart = mine.map_from_base.difference(theirs.map_from_base)[tangent]
        covariance = (mine.covariance + theirs.covariance)[np.ix_(tangent, tangent)]
        chi2 = float(apart @ np.linalg.solve(covariance, apart))
        return chi2 < chi2_limit(len(tangent), _ELSEWHERE)


def accounts_after(parent: Hypothesis, camera: str) -> list[Account]:
    """How a place may be right where a sighting of a camera contradicts a parent: the robot was
    lifted, and all else that the parent leaves open is still so; or what the parent explains was
    wrong, and its cameras were moved."""
    past = parent.account
    against = Counter(past.against)
    against[camera] = max(against[camera] - 1, 0)  # this sighting
    lifted = Account(parent.costs, past.before + parent.costs.event, Counter(past.sunk), against)
    return [lifted, Account(parent.costs, sunk=Counter(parent.agreeing))]


def begun(
    data: DataSet,
    cameras: dict[str, CameraState],
    covariance: Array,
    observation: Observation,
    time_ns: int,
    scales: Array,
) -> list[CurrentFilter]:
    """Filters of the robot at every place at which one sighting allows it to be, best first;
    `covariance` (6n, 6n): of the cameras; `scales` (2,): of its odometry."""
    camera, robot = cameras[observation.camera], observation.robot
    target, tangent = data.targets[robot], data.tracks[robot].tangent
    row = 6 * list(cameras).index(observation.camera)
    own = covariance[row : row + 6, row : row + 6]
    found = []
    eye = camera.map_from_camera
    for pose in placements(observation, target, camera.lens, eye, tangent=tangent):
        distance = float(np.linalg.norm(pose.translation - eye.translation))
        aligned = align(
            observation,
            target,
            camera.lens,
            eye,
            tangent=tangent,
            prior=PosePrior(pose, _NEAR),
            extra_sigma_px=camera_sigma_px(camera.lens, own, distance),
        )
        if aligned is None:
            continue
        seen, there = aligned.read(observation), aligned.map_from_base
        known = _updated(data, cameras, covariance, seen, (time_ns, there, scales))
        if known is not None:
            found.append(CurrentFilter(data))
            found[-1].go_on_from(known)
    return found


def _updated(
    data: DataSet,
    cameras: dict[str, CameraState],
    covariance: Array,
    seen: Observation,
    place: tuple[int, Pose, Array],
) -> Filter | None:
    """The filter of a robot that was seen at a place; None where the sighting does not fit."""
    unknown = Filter.in_fixed_map(data, cameras, covariance, seen.robot, *place)
    try:
        after, surprise = unknown.updated(data, seen)
    except (LinAlgError, ValueError):
        return None
    return after if is_noise(surprise, 2 * seen.corner_count, excess=EXCESS) else None
