"""One visit by itself: every place of the camera, seen from where the robot then was, that its
pictures and the odometry between them allow."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.fusion.model.assembly import Assembled, assemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.prediction import (
    base_jacobian,
    batch_jacobians,
    batch_residual,
)
from trigpoint.fusion.model.problem import Batch, CameraState, Problem, State
from trigpoint.fusion.solver.levenberg_marquardt import Minimum, minimise
from trigpoint.fusion.solver.picture_jitter import PictureJitter
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .budget import Budget
from .events import Events
from .innovation import Corners, Stood, innovation_excess
from .linear import Linear, linearised, log_priors, unknowns_of
from .masks import likeliest_wrong
from .mode import Mode
from .sightings import wild_corners
from .system import System
from .trial import Trial

_MOST_ROUNDS = 10
_PATIENCE = 2
# What a step may still promise of χ²: far below what any decision rests on.
_TOLERANCE = 0.03
_MOST_STEPS = 12


class LocalProblem:
    """The chosen pictures of one camera by one robot, between which odometry is followed.

    `poses`: by index where odometry puts the robot; `wrong_scores`: by index, of each view.
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
        self.data, self.observations, self.poses = data, observations, poses
        self.wrong_scores, self.events = wrong_scores, events
        self.budget = budget if budget is not None else Budget()
        self._corners = sum(observation.corner_count for observation in observations.values())
        first = next(iter(observations.values()))
        self.camera, self.robot = first.camera, first.robot
        self.target = data.targets[self.robot]

    def mode_near(
        self,
        start: CameraState,
        wrong: dict[int, tuple[bool, ...]],
        most_wrong: int | None = None,
    ) -> Mode | None:
        """The mode that a camera near `start` leads to; None where nothing fits.

        `wrong`: by index, which views the start takes to be wrong; `most_wrong`: with more wrong
        ones than this it is given up once it had time to take them back.
        """
        trial = Trial({index: list(row) for index, row in wrong.items()}, dict(self.poses))
        camera, seen, settled = start, set[tuple[object, ...]](), None
        for round_ in range(_MOST_ROUNDS):
            trial.read(self.observations, self.target, camera)
            if trial.is_all_wrong:
                return None
            is_first = round_ == 0
            solved = self._solved(trial, camera, huber=HUBER_SIGMAS if is_first else np.inf)
            if solved is None:
                return None
            camera, read = solved.state.cameras[self.camera], trial.signature
            self._move(trial, solved)
            self._judge(trial, solved, is_robust=is_first)
            if most_wrong is not None and round_ >= _PATIENCE and trial.wrong_count > most_wrong:
                return None
            signature = trial.signature
            settled = solved if signature == read and not is_first else None
            if signature in seen:
                break
            seen.add(signature)
        return self._mode(trial, settled or self._solved(trial, camera, huber=np.inf))

    # -- the solution -----------------------------------------------------------------------------

    def _solved(self, trial: Trial, camera: CameraState, *, huber: float) -> "_Solved | None":
        assembled = self._assembled(trial, camera)
        try:
            found = minimise(
                assembled.problem,
                assembled.start,
                huber=huber,
                tolerance=_TOLERANCE,
                most_iterations=_MOST_STEPS,
            )
        except LinAlgError:
            return None  # it went where nothing is determined
        self.budget.spend_solving(steps=found.iterations, corners=self._corners)
        if not np.isfinite(found.equations.cost):
            return None
        return _Solved(assembled, found, is_robust=np.isfinite(huber))

    def _assembled(self, trial: Trial, camera: CameraState) -> Assembled:
        entries = []
        for index, observation in self.observations.items():
            outliers = tuple(
                np.ones_like(wild) if wrong else wild
                for wrong, wild in zip(trial.wrong[index], trial.wild[index], strict=True)
            )
            chosen = tuple(trial.readings[index])
            read = replace(observation, chosen=chosen, outliers=outliers)
            entries.append(Entry(read.judged(Verdict.ACCEPTED), trial.poses[index]))
        small = replace(self.data, entries=entries)
        state = State({self.camera: camera}, self.data.first_state().robots)
        return assemble(small, state, list(range(len(entries))), anchored=False)

    def _move(self, trial: Trial, solved: "_Solved") -> None:
        robot = solved.state.robots[self.robot]
        indices = list(self.observations)
        for order, node in solved.assembled.node_of.items():
            trial.poses[indices[order]] = robot.map_from_base[node]
        if solved.assembled.problem.priors.faces:
            trial.faces = robot.base_from_face

    # -- what is wrong ----------------------------------------------------------------------------

    def _judge(self, trial: Trial, solved: "_Solved", *, is_robust: bool) -> None:
        """Say which corners are wild, and which sightings would better be wrong, or right.

        `is_robust`: the state is a robust minimum, at which only the worst is sure to be wrong.
        """
        try:
            system = solved.system
        except LinAlgError:
            return
        assembled, state = solved.assembled, solved.state
        (batch,) = assembled.problem.batches
        whole = replace(batch, weights=self._weights(batch))
        jacobian, residual, columns, by_base = batch_jacobians(assembled.problem, whole, state)
        dense = system.dense_row + columns
        rows = [
            np.concatenate([system.node_rows(self.robot, int(node)), dense]) for node in batch.nodes
        ]
        # The last of the way to the minimum is nothing beside the noise, but much beside what a
        # sighting leaves over that says nearly alone where something is.
        rest = 0.0 if is_robust else 1.0
        left = residual + rest * np.stack(
            [each @ system.step[mine] for each, mine in zip(jacobian, rows, strict=True)]
        )
        wild = self._wild(by_base, left)
        good = np.zeros(batch.weights.shape, dtype=bool)
        for (row, index, order, part), flags in zip(self._parts(), wild, strict=True):
            good[row, part] = ~flags & (not trial.wrong[index][order])
        stood = _stood(assembled.problem, whole, state, jacobian, left, good)
        excess: dict[bool, list[tuple[float, int, int]]] = {False: [], True: []}
        for (row, index, order, part), flags in zip(self._parts(), wild, strict=True):
            trial.wild[index][order] = flags
            is_wrong = trial.wrong[index][order]
            corners = Corners(left[row, part], by_base[row, part], jacobian[row, part])
            covariance = system.covariance[np.ix_(rows[row], rows[row])]
            if stood is not None:
                corners, covariance = stood.beside(row, corners, covariance)
            gain = innovation_excess(
                corners.without(flags),
                covariance,
                self.events,
                is_used=not is_wrong,
                rest=_TOLERANCE if is_robust else 0.0,
            )
            excess[is_wrong].append((gain, index, order))
        most = max((gain for gain, *_ in excess[False]), default=0.0)
        judged = set[int]()
        for gain, index, order in sorted(excess[False], reverse=True):
            # Of two that contradict each other in one picture, the other may be right.
            if gain > 0 and gain >= (most if is_robust else most / 2) and index not in judged:
                trial.wrong[index][order] = True
                judged.add(index)
        if most > 0:
            return
        for gain, index, order in excess[True]:
            if gain < 0 and (index, order) not in trial.hidden:
                trial.wrong[index][order] = False

    def _parts(self) -> Iterator[tuple[int, int, int, slice]]:
        """Each view: the row of its picture, the index of that, its order and its corners there."""
        for row, (index, observation) in enumerate(self.observations.items()):
            for order, part in enumerate(observation.parts):
                yield row, index, order, part

    def _wild(self, by_base: Array, residual: Array) -> list[np.ndarray]:
        """Of each view, which corners are wild."""
        parts = [(by_base[row, part], residual[row, part]) for row, _, _, part in self._parts()]
        return wild_corners(parts, self.events.wild_score)

    def _weights(self, batch: Batch) -> Array:
        """1/sigma of every corner (n, K), also of those that are left out."""
        weights = np.zeros_like(batch.weights)
        for row, observation in enumerate(self.observations.values()):
            weights[row, : observation.corner_count] = 1 / observation.sigmas
        return weights

    # -- to first order ---------------------------------------------------------------------------

    def residuals(self, mode: Mode) -> Linear | None:
        """The visit to first order about a mode, each picture as one, without what is wrong by it;
        None where that tells nothing of noise."""
        readings = {
            index: [
                reading if reading is not None else view.readings[0]
                for reading, view in zip(mode.readings[index], observation.views, strict=True)
            ]
            for index, observation in self.observations.items()
        }
        wrong = {index: [r is None for r in row] for index, row in mode.readings.items()}
        wild = {index: list(row) for index, row in mode.wild.items()}
        assembled = self._assembled(Trial(wrong, dict(mode.poses), readings, wild), mode.camera)
        (batch,) = assembled.problem.batches
        return linearised(
            self.data, assembled, batch, [(row, None) for row in range(len(batch.nodes))]
        )

    def likeliest_wrong(self, mode: Mode) -> list[dict[int, tuple[bool, ...]]]:
        """Which sightings are wrong, likeliest first, by everything about a mode to first order:
        those that one after the other would never be found, since several agree by chance."""
        trial = Trial({}, dict(mode.poses))
        trial.read(self.observations, self.target, mode.camera)
        assembled = self._assembled(trial, mode.camera)
        (batch,) = assembled.problem.batches
        shown = [each for each in self._parts() if not trial.wrong[each[1]][each[2]]]
        parts: list[tuple[int, slice | None]] = [(row, part) for row, _, _, part in shown]
        linear = linearised(self.data, assembled, self._tame(assembled, batch), parts)
        if linear is None:
            return []
        self.budget.spend_filtering(parts=len(linear.parts), unknowns=len(linear.prior))
        found = []
        for flags in likeliest_wrong(linear, self.data.jitter.get(self.robot), self.events):
            wrong = {index: [True] * len(o.views) for index, o in self.observations.items()}
            for number, is_wrong in zip(linear.parts, flags, strict=True):
                _, index, order, _ = shown[number]
                wrong[index][order] = is_wrong
            found.append({index: tuple(row) for index, row in wrong.items()})
        return found

    def _tame(self, assembled: Assembled, batch: Batch) -> Batch:
        """A batch without the corners that each sighting by itself shows to be wild."""
        whole = replace(batch, weights=self._weights(batch))
        state = assembled.start
        residual = batch_residual(assembled.problem, whole, state)
        by_base = base_jacobian(assembled.problem, whole, state)
        weights = whole.weights.copy()
        wild = self._wild(by_base, residual)
        for (row, _, _, part), flags in zip(self._parts(), wild, strict=True):
            weights[row, part] *= ~flags
        return replace(batch, weights=weights)

    # -- the result -------------------------------------------------------------------------------

    def _mode(self, trial: Trial, solved: "_Solved | None") -> Mode | None:
        if solved is None or trial.is_all_wrong:
            return None
        self._move(trial, solved)
        assembled, state, problem = solved.assembled, solved.state, solved.assembled.problem
        try:
            system = solved.system
        except LinAlgError:
            return None
        rows = system.dense_row + unknowns_of(problem, self.camera)
        covariance = system.covariance[np.ix_(rows, rows)]
        information = np.linalg.inv(covariance)
        score = system.cost + system.log_determinant - float(np.linalg.slogdet(information)[1])
        own, others = log_priors(problem, self.camera, self.robot)
        score += self._odometry_score(assembled) + self._left_out_score(trial) - others
        return Mode(
            state.cameras[self.camera],
            symmetric(information),
            own,
            score,
            {
                index: tuple(
                    None if wrong else reading
                    for reading, wrong in zip(row, trial.wrong[index], strict=True)
                )
                for index, row in trial.readings.items()
            },
            {index: tuple(row) for index, row in trial.wild.items()},
            dict(trial.poses),
            self._poses_covariance(assembled, system),
            self._early_s(assembled),
            self._scales(problem, state, system),
            trial.faces,
        )

    def _poses_covariance(self, assembled: Assembled, system: System) -> Array:
        """(m, d, m, d) of where the robot stood."""
        count = len(self.observations)
        nodes = [system.node_rows(self.robot, assembled.node_of[row]) for row in range(count)]
        rows = np.concatenate(nodes)
        return system.covariance[np.ix_(rows, rows)].reshape(count, -1, count, len(nodes[0]))

    def _early_s(self, assembled: Assembled) -> float:
        """By how much before a picture is stamped its node stands."""
        first_ns = next(iter(self.observations.values())).stamp_ns
        since_epoch_s = self.data.since_epoch_s(first_ns)
        return float(assembled.start.cameras[self.camera].offset_s(since_epoch_s))

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
        score = 0.0
        for index, observation in self.observations.items():
            for order in range(len(observation.views)):
                if trial.wrong[index][order]:
                    score += self.wrong_scores[index][order]
                else:
                    score += self.events.wild_score * int(trial.wild[index][order].sum())
        return score


class _Solved:
    """A visit at a minimum; `state`: there; a robust one's equations are those of the robust
    cost, and of no use for what is known there."""

    def __init__(self, assembled: Assembled, found: Minimum, *, is_robust: bool) -> None:
        self.assembled, self.state = assembled, found.state
        self._equations = None if is_robust else found.equations

    @cached_property
    def system(self) -> System:
        """Raise LinAlgError where something is not determined."""
        return System.of(self.assembled.problem, self.state, self._equations)


def _stood(
    problem: Problem, batch: Batch, state: State, jacobian: Array, residual: Array, good: np.ndarray
) -> Stood | None:
    """How the robot stood in each picture by its `good` corners (n, K); None where it stands as its
    odometry says. `jacobian` (n, K, 2, q) and `residual` (n, K, 2): of all corners."""
    jitter = PictureJitter.of(problem, replace(batch, weights=batch.weights * good), state)
    if jitter is None:
        return None
    by_state = (jacobian * good[..., None, None]).reshape(len(residual), -1, jacobian.shape[-1])
    return Stood.of(jitter, by_state, (residual * good[..., None]).reshape(len(residual), -1))
