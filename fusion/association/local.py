"""Solves one visit by itself: finds every pose of its camera relative to the robot that the
visit's pictures and the odometry between them allow."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError

from trigpoint.fusion.model.assembly import Assembled, assemble, reassemble
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.observations import Observation, Verdict
from trigpoint.fusion.model.prediction import (
    base_jacobian,
    batch_jacobians,
    batch_residual,
)
from trigpoint.fusion.model.problem import Batch, CameraState, Problem, State
from trigpoint.fusion.solver.equations import System
from trigpoint.fusion.solver.levenberg_marquardt import Minimum, minimise
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array
from trigpoint.geometry.uncertainty import symmetric

from .budget import Budget
from .events import Events
from .innovation import Linearised, judged
from .linear import Linear, linearised, log_priors, unknowns_of
from .masks import likeliest_wrong
from .mode import Mode
from .sightings import wild_corners
from .trial import Trial

_MOST_ROUNDS = 10
_PATIENCE = 2
# The iteration ends at a step that promises to lower χ² by less than this, which is far below what
# any decision depends on.
_TOLERANCE = 0.03
_MOST_STEPS = 12


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
        self.data, self.observations, self.poses = data, observations, poses
        self.wrong_scores, self.events = wrong_scores, events
        self.budget = budget if budget is not None else Budget()
        self._corners = sum(observation.corner_count for observation in observations.values())
        first = next(iter(observations.values()))
        self.camera, self.robot = first.camera, first.robot
        self.target = data.targets[self.robot]
        self._robots = data.first_state().robots
        self._assembled_before: Assembled | None = None

    def mode_near(
        self,
        start: CameraState,
        wrong: dict[int, tuple[bool, ...]],
        most_wrong: int | None = None,
    ) -> Mode | None:
        """The mode that the iteration reaches from a camera near `start`; None where nothing fits.

        `wrong`: by index, which views are taken as wrong at the start; `most_wrong`: the search is
        given up where more views than this are still wrong after `_PATIENCE` rounds.
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
            return None  # at a state where an unknown is not determined
        self.budget.spend_solving(steps=found.iterations, corners=self._corners)
        return _Solved(assembled, found) if np.isfinite(found.cost) else None

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
        state, before = State({self.camera: camera}, self._robots), self._assembled_before
        # Where a picture's node lies depends on the clock alone.
        if before is not None and before.start.cameras[self.camera].clock == camera.clock:
            return reassemble(before, small, state)
        self._assembled_before = assemble(small, state, list(range(len(entries))), anchored=False)
        return self._assembled_before

    def _move(self, trial: Trial, solved: "_Solved") -> None:
        robot = solved.state.robots[self.robot]
        indices = list(self.observations)
        for order, node in solved.assembled.node_of.items():
            trial.poses[indices[order]] = robot.map_from_base[node]
        if solved.assembled.problem.priors.faces:
            trial.faces = robot.base_from_face

    # -- what is wrong ----------------------------------------------------------------------------

    def _judge(self, trial: Trial, solved: "_Solved", *, is_robust: bool) -> None:
        """Mark the wild corners, and the sightings that are likelier wrong, or right, than taken.

        `is_robust`: the state minimises the robust cost; only the worst sighting is then sure to be
        wrong.
        """
        try:
            system = solved.system
        except LinAlgError:
            return
        assembled, state = solved.assembled, solved.state
        (batch,) = assembled.problem.batches
        whole = replace(batch, weights=self._weights(batch))
        jacobian, residual, columns, by_base = batch_jacobians(assembled.problem, whole, state)
        nodes = [system.node_rows(self.robot, int(node)) for node in batch.nodes]
        rows = np.array([np.concatenate([node, system.dense_row + columns]) for node in nodes])
        parts = list(self._parts())
        # What is left of the way to the minimum is negligible beside the noise, but not beside the
        # residual of a sighting that nearly alone determines an unknown.
        gains, wild = judged(
            Linearised(
                by_base, residual, jacobian, rows, system.step, system.covariance, batch.jitter
            ),
            np.array([(row, part.start, part.stop) for row, *_, part in parts]),
            np.array([trial.wrong[index][order] for _, index, order, _ in parts]),
            self.events,
            way=0.0 if is_robust else 1.0,
            rest=_TOLERANCE if is_robust else 0.0,
        )
        excess: dict[bool, list[tuple[float, int, int]]] = {False: [], True: []}
        for (row, index, order, part), gain in zip(parts, gains.tolist(), strict=True):
            trial.wild[index][order] = wild[row, part]
            excess[trial.wrong[index][order]].append((gain, index, order))
        most = max((gain for gain, *_ in excess[False]), default=0.0)
        taken = set[int]()
        for gain, index, order in sorted(excess[False], reverse=True):
            # Of two sightings that contradict each other in one picture, the other may be right.
            if gain > 0 and gain >= (most if is_robust else most / 2) and index not in taken:
                trial.wrong[index][order] = True
                taken.add(index)
        if most > 0:
            return
        for gain, index, order in excess[True]:
            if gain < 0 and (index, order) not in trial.hidden:
                trial.wrong[index][order] = False

    def _parts(self) -> Iterator[tuple[int, int, int, slice]]:
        """For each view: its picture's row and index, and its own order and corners therein."""
        for row, (index, observation) in enumerate(self.observations.items()):
            for order, part in enumerate(observation.parts):
                yield row, index, order, part

    def _wild(self, by_base: Array, residual: Array) -> list[np.ndarray]:
        """Flags of the wild corners of each view."""
        parts = [(by_base[row, part], residual[row, part]) for row, _, _, part in self._parts()]
        return wild_corners(parts, self.events.wild_score)

    def _weights(self, batch: Batch) -> Array:
        """1/sigma of every corner (n, K), including those that are left out."""
        weights = np.zeros_like(batch.weights)
        for row, observation in enumerate(self.observations.values()):
            weights[row, : observation.corner_count] = 1 / observation.sigmas
        return weights

    # -- to first order ---------------------------------------------------------------------------

    def residuals(self, mode: Mode) -> Linear | None:
        """The visit linearised about a mode, with each picture as one part and without what the
        mode has as wrong; None where that tells nothing about the noise."""
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
        """The likeliest sets of wrong sightings, best first, by the visit linearised about a mode.
        Judged one after the other they would never be found, since several agree by chance."""
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
        """The batch without the corners that each sighting by itself shows to be wild."""
        whole = replace(batch, weights=self._weights(batch))
        state = assembled.start
        residual = batch_residual(whole, state)
        by_base = base_jacobian(whole, state)
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
        """Joint covariance (m, d, m, d) of the robot's poses at the m pictures."""
        count = len(self.observations)
        nodes = [system.node_rows(self.robot, assembled.node_of[row]) for row in range(count)]
        rows = np.concatenate(nodes)
        return system.covariance[np.ix_(rows, rows)].reshape(count, -1, count, len(nodes[0]))

    def _early_s(self, assembled: Assembled) -> float:
        """How long before a picture's stamp its node lies: the time offset, by which the problem
        was assembled, at the first picture."""
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
    """A visit's problem and `state` at a minimum."""

    def __init__(self, assembled: Assembled, found: Minimum) -> None:
        self.assembled, self.state = assembled, found.state
        self._equations = found.equations

    @cached_property
    def system(self) -> System:
        """The full normal equations; raise LinAlgError where an unknown is not determined."""
        return self._equations.system()
