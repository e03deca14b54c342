"""Solves one visit by itself: finds every pose of its camera relative to the robot that the
visit's pictures and the odometry between them allow."""

from typing import TypeVar

import numpy as np
from msgspec.structs import replace
from numpy.linalg import LinAlgError

from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.jitter import Jitter
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.problem import CameraState, Problem, State
from trigpoint.fusion.solver.equations import System
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric
from trigpoint.native.library import In, Kernel, Out

from .budget import Budget
from .events import Events, window
from .linear import EQUATIONS, Linear, linearised, log_priors, unknowns_of
from .mode import Mode
from .trial import Ending, Pictures, Trial, Work

_MOST_ROUNDS = 10
_PATIENCE = 2
_ROUND = Work.READ | Work.SOLVE | Work.JUDGE
_FIRST = _ROUND | Work.ROBUST
# Accepting a right sighting early improves the score by seventy or so, but only once others agree
# with it. So the score of a partial hypothesis tells little, and as many hypotheses are carried on
# as six sightings have subsets.
_MOST = 64
_MOST_TOLD = 3
_REAL = np.float64
_LIKELIEST = Kernel(
    "tp_likeliest_wrong",
    *EQUATIONS,
    *(In(_REAL, ("m", "d", "d")), In(_REAL, (6,))),
    *(float, float),
    *(Out(_REAL, ("k",)), Out(np.bool_, ("k", "n"))),
)
Flag = TypeVar("Flag")


class LocalProblem:
    """The least-squares problem of one camera's chosen pictures of one robot, and its odometry.

    `poses`: by index, where odometry puts the robot; `wrong_scores`: by index, the score of each
    view if it is wrong.
    """

    def __init__(
        self,
        data: DataSet,
        observations: dict[int, Observation],
        poses: dict[int, Pose],
        wrong_scores: dict[int, tuple[float, ...]],
        events: Events,
        budget: Budget | None = None,
    ) -> None:
        self.data, self.observations, self.events = data, observations, events
        self.poses = Pose.stack([poses[index] for index in observations])
        scores = [score for index in observations for score in wrong_scores.get(index, ())]
        self._wrong_scores = np.array(scores, dtype=float)
        self._log_priors: tuple[float, float] | None = None  # the same for every mode
        self.budget = budget if budget is not None else Budget()
        self._corners = sum(observation.corner_count for observation in observations.values())
        self._pictures = Pictures(data, list(observations.values()), events)
        self.camera, self.robot = self._pictures.camera, self._pictures.robot

    def mode_near(
        self,
        start: CameraState,
        wrong: np.ndarray,
        most_wrong: int | None = None,
    ) -> Mode | None:
        """The mode that the iteration reaches from a camera near `start`; None where nothing fits.

        `wrong` (v,): which views are taken as wrong at the start; `most_wrong`: the search is
        given up where more views than this are still wrong after `_PATIENCE` rounds.
        """
        trial = Trial(self._pictures, start, self.poses, wrong.copy())
        seen, is_settled = set[tuple[bytes, ...]](), False
        for round_ in range(_MOST_ROUNDS):
            if round_ == 0:
                ending = self._gone_on(trial, _FIRST, huber=HUBER_SIGMAS)
            else:
                ending = self._gone_on(trial, _ROUND)
            if ending is Ending.NOTHING_FITS:
                return None
            if most_wrong is not None and round_ >= _PATIENCE and trial.wrong.sum() > most_wrong:
                return None
            is_settled = ending is Ending.JUDGED_SAME and round_ > 0
            if trial.signature in seen:
                break
            seen.add(trial.signature)
        if not is_settled and self._gone_on(trial, Work.SOLVE) is Ending.NOTHING_FITS:
            return None
        return self._mode(trial)

    def _gone_on(self, trial: Trial, work: Work, *, huber: float = np.inf) -> Ending:
        ending = trial.round(work, huber=huber)
        if trial.iterations:
            self.budget.spend_solving(steps=trial.iterations, corners=self._corners)
        return ending

    def wrong_by(self, mode: Mode) -> np.ndarray:
        """Which views (v,) a mode takes as wrong; none of a picture that it does not have."""
        rows = [mode.readings.get(i, o.views) for i, o in self.observations.items()]
        return np.array([reading is None for row in rows for reading in row], dtype=bool)

    def _by_index(self, flags: list[Flag]) -> dict[int, tuple[Flag, ...]]:
        """What is said of each view, by index of its picture."""
        ends = self._pictures.ends
        parts = zip(self.observations, [0, *ends[:-1]], ends, strict=True)
        return {index: tuple(flags[start:end]) for index, start, end in parts}

    # -- to first order ---------------------------------------------------------------------------

    def residuals(self, mode: Mode) -> Linear | None:
        """The visit linearised about a mode, with each picture as one part and without what the
        mode has as wrong; None where that tells nothing about the noise."""
        views = self._pictures.views
        readings = [reading for row in mode.readings.values() for reading in row]
        trial = Trial(self._pictures, mode.camera, self._stood(mode), self.wrong_by(mode))
        chosen = zip(views, readings, strict=True)
        trial.chosen[:] = [view.readings.index(r) if r is not None else 0 for view, r in chosen]
        trial.wild[:] = np.concatenate([wild for row in mode.wild.values() for wild in row])
        return linearised(trial, by_pictures=True)

    def likeliest_wrong(self, mode: Mode) -> list[np.ndarray]:
        """The likeliest sets of wrong views, (v,) bool each, best first, by the visit linearised
        about a mode. Judged one after the other they would never be found, since several agree by
        chance."""
        none = np.zeros(len(self._pictures.views), dtype=bool)
        trial = Trial(self._pictures, mode.camera, self._stood(mode), none)
        if trial.round(Work.READ) is Ending.NOTHING_FITS:
            return []
        linear = linearised(trial, by_pictures=False)
        if linear is None:
            return []
        self.budget.spend_filtering(parts=len(linear.parts), unknowns=len(linear.prior))
        found = []
        for flags in likeliest_wrong(linear, self.data.jitter.get(self.robot), self.events):
            wrong = np.ones(len(trial.wrong), dtype=bool)
            wrong[linear.parts] = flags
            found.append(wrong)
        return found

    def _stood(self, mode: Mode) -> Pose:
        return Pose.stack([mode.poses[index] for index in self.observations])

    # -- the result -------------------------------------------------------------------------------

    def _mode(self, trial: Trial) -> Mode | None:
        """The mode that a trial ended at; None where nothing determines it."""
        if trial.wrong.all():
            return None
        assembled, state = trial.tables.assembled, trial.state
        problem, robot = assembled.problem, state.robots[self.robot]
        try:
            system = trial.equations.system()
        except LinAlgError:
            return None
        rows = system.dense_row + unknowns_of(problem, self.camera)
        covariance = system.covariance[rows[:, None], rows]
        information = symmetric(np.linalg.inv(covariance))
        determinant = float(np.linalg.slogdet(information)[1])
        score = system.cost + system.log_determinant - determinant
        if self._log_priors is None:
            self._log_priors = log_priors(problem, self.camera, self.robot)
        own, others = self._log_priors
        score += self._odometry_score(assembled) + self._left_out_score(trial) - others
        chosen = zip(self._pictures.views, trial.chosen.tolist(), trial.wrong.tolist(), strict=True)
        readings = [None if wrong else view.readings[number] for view, number, wrong in chosen]
        wild = self._pictures.split(trial.wild.copy())
        return Mode(
            state.cameras[self.camera],
            information,
            score,
            score + determinant - own,
            self._by_index(readings),
            self._by_index(wild),
            {index: trial.poses[row] for row, index in enumerate(self.observations)},
            self._poses_covariance(assembled, system),
            trial.tables.early_s,
            self._scales(problem, state, system),
            robot.base_from_face if problem.priors.faces else None,
        )

    def _poses_covariance(self, assembled: Assembled, system: System) -> Array:
        """Joint covariance (m, d, m, d) of the robot's poses at the m pictures."""
        count = len(self.observations)
        nodes = [system.node_rows(self.robot, assembled.node_of[row]) for row in range(count)]
        rows = np.concatenate(nodes)
        return system.covariance[rows[:, None], rows].reshape(count, -1, count, len(nodes[0]))

    def _scales(self, problem: Problem, state: State, system: System) -> tuple[Array, Array] | None:
        if self.robot not in problem.layout.scales:
            return None
        rows = system.dense_row + problem.layout.scales[self.robot]
        return state.robots[self.robot].scales, system.covariance[np.ix_(rows, rows)]

    def _odometry_score(self, assembled: Assembled) -> float:
        chain = assembled.problem.chains[self.robot]
        if chain.motion is None:
            return 0.0
        free = np.ix_(range(len(chain) - 1), chain.tangent, chain.tangent)
        return float(np.sum(np.linalg.slogdet(chain.motion.covariance[free])[1]))

    def _left_out_score(self, trial: Trial) -> float:
        wild = np.bincount(self._pictures.view_of, trial.wild, len(trial.wrong))
        return float(np.where(trial.wrong, self._wrong_scores, self.events.wild_score * wild).sum())


def likeliest_wrong(
    linear: Linear, jitter: Jitter | None, events: Events
) -> list[tuple[bool, ...]]:
    """The likeliest sets of wrong parts of a visit, as n flags each, best first.

    Sightings that are judged one after the other can mask each other: two that are displaced alike
    make the right one between them look wrong. To first order a visit is one linear Gaussian model,
    in which each hypothesis (which of the sightings so far are wrong) is a Kalman filter of the
    robot's pose and of the camera; the likeliest are carried on from sighting to sighting.

    `jitter`: how far the robot's pose in each picture deviates from what odometry says.
    """
    if jitter is not None:
        linear = replace(linear, own=linear.own + np.diag(jitter.variances))
    scores, flags = np.empty(_MOST), np.empty((_MOST, len(linear.parts)), dtype=bool)
    kept = _LIKELIEST(
        *linear.equations,
        *(linear.spread, events.room_variances, events.wrong_limit, events.pose_score),
        *(scores, flags),
    )
    near = scores[:kept] < scores[0] + window()
    return [tuple(row) for row in flags[:kept][near][:_MOST_TOLD].tolist()]
