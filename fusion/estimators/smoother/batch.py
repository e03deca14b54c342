"""The batch solution: everything that came in, worked out together.

In goes the data set: observations with a verdict, a reading and a guess of where the robot stood,
and the robots' odometry. Out come

- the `state` (cameras, robots, scales), its `solution` and the `assembled` problem behind it;
- a `Filter` with what is known at the end, which `solve` and `finish` return;
- in the data set's entries: verdicts, outliers, readings, shares, and where the robot stood;
- `undetermined`: what is not known of the cameras that could not be located.

One solution goes: readmit what was set aside, solve and judge in rounds until nothing changes, say
where the robot stood at what is not used, drop a camera that most of its pictures contradict.
"""

from collections import Counter

import numpy as np

from trigpoint.fusion.association.engine import explain
from trigpoint.fusion.association.events import Events
from trigpoint.fusion.association.explanation import CameraFinding, Explanation
from trigpoint.fusion.association.modes import Memory
from trigpoint.fusion.estimators import outlier_rejection
from trigpoint.fusion.estimators.marginals import camera_estimates
from trigpoint.fusion.estimators.smoother import odometry_noise, standstill_noise
from trigpoint.fusion.initialisation.cameras import Located, Undetermined, locate
from trigpoint.fusion.model.assembly import Assembled
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import HUBER_SIGMAS
from trigpoint.fusion.model.observations import Observation, Verdict, observation_of
from trigpoint.fusion.model.problem import State
from trigpoint.fusion.model.trajectory import interpolated
from trigpoint.fusion.solver.filter import Filter
from trigpoint.fusion.solver.levenberg_marquardt import Solution
from trigpoint.fusion.solver.relinearisation import solve_consistently
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .change_reports import why_undetermined
from .contradicting_sightings import leave_out_contradicting
from .explained_data import apply_explanation
from .placement import place
from .readmission import Readmission

_MOST_ROUNDS = 6
_MOST_ROUGH_ROUNDS = 2
_MOST_SETTLING = 3
_MOST_LOCATED = 3
# A turn's second order in a scale error of this prior sigma is what a visit's poses are known by.
_ROUGH_SCALE = 0.05
# How much is taken in at once of what was collected: so many observations, then this many times
# what there is.
_FIRST_STRETCH = 64
_GROWTH = 3
# What a step may still promise of χ² at the end: 0.3, 0.1 and 0.01 of a sigma.
_ROUGH_TOLERANCE = 0.1
LIVE_TOLERANCE = 1e-2
FINAL_TOLERANCE = 1e-4
_LEAST_PICTURES = 3
# Of a variance: what changes no sigma by more than a two-hundredth.
_LITTLE_SPREAD = 0.01
_GROWTH_TO_RETRY = 1.2


class BatchSolution:
    """The solution over a data set, redone on demand. Not thread-safe."""

    def __init__(self, data: DataSet) -> None:
        self.data = data
        self.state = data.first_state()
        self.solution: Solution | None = None
        self.assembled: Assembled | None = None
        self.undetermined: dict[str, tuple[str, ...]] = {}
        # How many pictures each camera had when it was last tried to locate it, and by how many
        # each robot when it was last tried in vain to locate it in the map.
        self.tries: dict[str, int] = {}
        self._robot_tries: dict[str, int] = {}
        # By robot that is not located in the map: why.
        self._robot_reasons: dict[str, str] = {}
        self.tolerance = LIVE_TOLERANCE
        self.iterations = 0
        # What was collected without an estimate, and is not in the data set yet.
        self.collected: list[Observation] = []
        # Entries of which it is not known yet what they mean: they stay set aside.
        self.undecided: set[int] = set()
        self._readmission = Readmission(data)
        self.explanation: Explanation | None = None
        self._memory = Memory()

    # -- solving ----------------------------------------------------------------------------------

    def finish(self, known: Filter | None) -> Filter | None:
        """Find what explains all that came in, and solve that to the end."""
        if not any(len(track) for track in self.data.tracks.values()):
            return known
        if not self._is_explainable():
            return self._finished_by_rules(known)
        observations = self._all()
        if not observations:
            return known
        self.explanation = explanation = explain(self.data, observations, memory=self._memory)
        self.state = apply_explanation(self.data, explanation)
        self.undetermined = {
            camera: (finding.reason,)
            for camera, finding in explanation.findings.items()
            if finding.reason
        }
        return self._solved_as_explained()

    def _is_explainable(self) -> bool:
        """Whether the association can explain the session: it takes the odometry's scales to first
        order."""
        return all(
            max(robot.odometry.distance_scale, robot.odometry.heading_scale) <= _ROUGH_SCALE
            for robot in self.data.site.robots.values()
        )

    def _finished_by_rules(self, known: Filter | None) -> Filter | None:
        """Locate what can be located and solve to the end without the association."""
        self.undecided = set()
        self.tolerance = FINAL_TOLERANCE
        try:
            return self._finished(self._take_in(known))
        finally:
            self.tolerance = LIVE_TOLERANCE

    def _finished(self, known: Filter | None) -> Filter | None:
        found: Counter[str] = Counter()
        for _ in range(len(self.data.camera_names) + len(self.data.site.robots) + 1):
            known = self.solve(known)
            located = [robot for robot in self.data.site.robots if self.locate_robot(robot, known)]
            missing = [
                name
                for name in self.data.camera_names
                if name not in self.state.cameras and self.data.of_camera(name)
            ]
            # One that is located and dropped again and again would go on so.
            again = [n for n in missing if found[n] < _MOST_LOCATED and self.locate(n)]
            found.update(again)
            if not again and not located:
                break
        return self._settle(known)

    def _settle(self, known: Filter | None) -> Filter | None:
        """Solve until the set of rejected observations is stable: a wrong one pulls good ones
        away."""
        for _ in range(_MOST_SETTLING):
            before = self._rejected()
            if not before:
                break
            known = self.solve(known)
            if self._rejected() == before:
                break
        return known

    def _rejected(self) -> set[int]:
        entries = self.data.entries
        return {i for i, e in enumerate(entries) if e.observation.verdict is Verdict.REJECTED}

    def _take_in(self, known: Filter | None) -> Filter | None:
        """Add what was collected without an estimate, in ever larger stretches of time."""
        while known is not None:
            has_grown = self._extend()
            without_place = self._without_place()
            for robot, indices in without_place.items():
                if known.has_robot(robot):
                    place(self.data, known, robot, indices)
                else:
                    self.locate_robot(robot, known)
            if not has_grown and self._without_place() == without_place:
                break
            for camera in self.data.camera_names:
                if camera not in self.state.cameras and self.is_due(camera):
                    self.locate(camera)
            known = self.solve(known, is_rough=True)
        return known

    def _extend(self) -> bool:
        """Add the next stretch of collected observations to the data set; whether there was one."""
        count = max(_FIRST_STRETCH, (_GROWTH - 1) * len(self.data.entries))
        stretch, self.collected = self.collected[:count], self.collected[count:]
        self.data.entries.extend(Entry(observation) for observation in stretch)
        return bool(stretch)

    def _solved_as_explained(self) -> Filter:
        """Solve over what the explanation uses, until its noise is stable."""
        used = self.data.usable(self.state.cameras)
        if not used:
            self.assembled = self.solution = None
            return Filter.at_origin(self.data)
        for _ in range(_MOST_ROUNDS):
            solved = solve_consistently(
                self.data, self.state, used, huber=np.inf, tolerance=FINAL_TOLERANCE
            )
            self.state, self.iterations = solved.state, self.iterations + solved.iterations
            self.assembled, self.solution = solved.assembled, solved.solution
            changed = leave_out_contradicting(
                self.data, self.assembled, self.state, Events(self.data.site.fusion.priors)
            )
            used = self.data.usable(self.state.cameras)
            changed |= standstill_noise.share_out(self.data, self.assembled, self.state)
            changed |= odometry_noise.learn(self.data, self.assembled, self.state)
            if not changed:
                break
        assert self.assembled is not None
        assert self.solution is not None
        self._forget_unused(self.assembled)
        known = Filter.after(self.state, self.assembled.problem, self.solution.reduced)
        known = known.spread(self._left_open())
        self._say_earlier(known)
        self._guess_rest()
        return known

    def _left_open(self) -> dict[str, Array]:
        """By located camera, the covariance (6, 6) of what explanations that put it at one place
        leave open there: which of two faces that contradict each other is wrong, say."""
        found = {}
        for camera in self.state.cameras:
            finding = self.finding(camera)
            if finding is None or not finding.is_located:
                continue
            place = finding.alternatives[0]
            if np.trace(np.linalg.solve(place.covariance, place.spread)) > _LITTLE_SPREAD:
                found[camera] = place.spread
        return found

    def finding(self, camera: str) -> CameraFinding | None:
        """What the last explanation says of a camera."""
        return self.explanation.findings.get(camera) if self.explanation is not None else None

    def _all(self) -> list[Observation]:
        """Every observation as it came, in order of time."""
        came = [entry.observation for entry in self.data.entries] + self.collected
        self.collected = []
        found = [
            observation_of(self.data.site_camera(o.camera), o.robot, o.stamp_ns, o.views)
            for o in came
        ]
        return sorted(found, key=lambda observation: observation.stamp_ns)

    def _without_place(self) -> dict[str, list[int]]:
        """By robot the entries without a pose of it, in the order in which they came."""
        found: dict[str, list[int]] = {}
        for index, entry in enumerate(self.data.entries):
            if entry.map_from_base is None:
                found.setdefault(entry.observation.robot, []).append(index)
        return found

    def is_due(self, camera: str) -> bool:
        """Whether a camera's pictures have grown by half since the last attempt to locate it."""
        pictures = self._placed_count(camera)
        return pictures >= max(_LEAST_PICTURES, 1.5 * self.tries.get(camera, 0))

    def _placed_count(self, camera: str) -> int:
        """How many of a camera's pictures show a robot whose pose is known."""
        return sum(entry.map_from_base is not None for entry in self.data.of_camera(camera))

    def locate_robot(self, robot: str, known: Filter | None) -> bool:
        """Try to locate a robot, or a disconnected part of its trajectory, in the map, where
        located cameras saw more of it than at the last attempt; whether that succeeded. The next
        solution uses it."""
        if known is None:
            return False
        indices = self._without_place().get(robot, [])
        seen = sum(known.has_camera(self.data.entries[i].observation.camera) for i in indices)
        if not seen or seen < _GROWTH_TO_RETRY * self._robot_tries.get(robot, 0):
            return False
        robot_reasons = place(self.data, known, robot, indices)
        if robot_reasons is not None:
            self._robot_tries[robot], self._robot_reasons[robot] = seen, robot_reasons.reason
            return False
        self._robot_tries.pop(robot, None)
        self._robot_reasons.pop(robot, None)
        return True

    def solve(self, known: Filter | None, *, is_rough: bool = False) -> Filter | None:
        """Solve over everything; observations that contradict the rest are set aside.

        `known`: the estimate so far; `is_rough`: only as exactly as needed to continue. Returns the
        new estimate; `known`, where there is nothing to solve.
        """
        self._readmit(known)
        rounds = self._rounds(is_rough=is_rough)
        if rounds is None:
            return known
        self.assembled, self.solution = rounds
        self._forget_unused(self.assembled)
        known = Filter.after(self.state, self.assembled.problem, self.solution.reduced)
        self._say_earlier(known)
        self._guess_rest()
        dropped = self._drop_misplaced()
        return self.solve(known, is_rough=is_rough) if dropped else known

    def _say_earlier(self, known: Filter) -> None:
        """Set the poses that cameras had before they were moved, as known now."""
        estimates = camera_estimates(known, [move.name for move in self.data.moves])
        for move in self.data.moves:
            if move.name in estimates:
                move.map_from_camera = estimates[move.name].map_from_camera
                move.covariance = estimates[move.name].covariance

    def _rounds(self, *, is_rough: bool) -> tuple[Assembled, Solution] | None:
        """Solve and judge until nothing changes; None where nothing is left to solve."""
        used = self.data.usable(self.state.cameras)
        last = None
        for round_ in range(_MOST_ROUGH_ROUNDS if is_rough else _MOST_ROUNDS):
            if not used:
                return None
            starts = round_ == 0
            last = assembled, _ = self._solve_used(used, is_rough=is_rough or starts)
            changed = outlier_rejection.judge(self.data, assembled, self.state)
            if not (is_rough or starts):
                changed |= standstill_noise.share_out(self.data, assembled, self.state)
                changed |= odometry_noise.learn(self.data, assembled, self.state)
            used = self.data.usable(self.state.cameras)
            if not changed and (is_rough or not starts):
                break
        return last if used else None

    def _solve_used(self, used: list[int], *, is_rough: bool) -> tuple[Assembled, Solution]:
        tolerance = _ROUGH_TOLERANCE if is_rough else self.tolerance
        huber = HUBER_SIGMAS if is_rough else np.inf
        solved = solve_consistently(self.data, self.state, used, huber=huber, tolerance=tolerance)
        self.state = solved.state
        self.iterations += solved.iterations
        return solved.assembled, solved.solution

    # -- what was set aside -----------------------------------------------------------------------

    def _readmit(self, known: Filter | None) -> None:
        """Retry observations that were set aside, and set the missing poses of robots."""
        for index, entry in enumerate(self.data.entries):
            observation = entry.observation
            if observation.camera not in self.state.cameras or index in self.undecided:
                continue
            outlier_rejection.reconsider(self.data, self.state, index)
            if entry.map_from_base is None:
                entry.map_from_base = self.pose_at(known, observation.robot, observation.stamp_ns)
            if entry.map_from_base is None or observation.verdict is Verdict.ACCEPTED:
                continue
            if known is None or not known.has_camera(observation.camera):
                continue  # located just now: the next solution looks at it again
            chains = self.assembled.problem.chains if self.assembled else {}
            self._readmission.look_again(index, known, chains.get(observation.robot))

    def _forget_unused(self, assembled: Assembled) -> None:
        """Cameras all of whose observations were rejected are no longer located."""
        kept = {n: c for n, c in self.state.cameras.items() if n in assembled.problem.layout.pose}
        self.state = State(kept, self.state.robots)

    def _guess_rest(self) -> None:
        """Set the robot's pose at every observation that is not used, by the new solution."""
        open_: dict[str, list[Entry]] = {}
        for entry in self.data.entries:
            if entry.observation.verdict is not Verdict.ACCEPTED:
                open_.setdefault(entry.observation.robot, []).append(entry)
        for robot, entries in open_.items():
            for entry, pose in zip(entries, self._poses_at(robot, entries), strict=True):
                entry.map_from_base = pose

    def _poses_at(self, robot: str, entries: list[Entry]) -> list[Pose | None]:
        """Where a robot stood at observations, by the last solution and odometry."""
        chain = self.assembled.problem.chains.get(robot) if self.assembled else None
        if chain is None:
            return [None] * len(entries)
        track = self.data.tracks[robot]
        stamps = np.array([entry.observation.stamp_ns for entry in entries])
        nodes = self.state.robots[robot].map_from_base
        moments = np.clip(stamps, track.first_ns, track.last_ns)
        poses = interpolated(track, chain, nodes, moments)
        is_reached = self._is_reached(robot, moments)
        return [poses[i] if is_reached[i] else None for i in range(len(entries))]

    def _is_reached(self, robot: str, moments: np.ndarray) -> np.ndarray:
        """Whether odometry connects moments (n,) of a robot to a used sighting or to the map's
        origin: it does not across a jump or a break."""
        assert self.assembled is not None
        track, problem = self.data.tracks[robot], self.assembled.problem
        chain = problem.chains[robot]
        seen = [batch.nodes for batch in problem.batches if batch.robot == robot]
        nodes = np.concatenate([*seen, np.zeros(int(chain.is_anchored), dtype=int)])
        return np.isin(track.pieces(moments), track.pieces(chain.stamps_ns[nodes]))

    def pose_at(self, known: Filter | None, robot: str, stamp_ns: int) -> Pose | None:
        """The robot's pose at a moment, as far as it is known now."""
        if known is None or not known.has_robot(robot):
            return None
        track, moment = self.data.tracks[robot], np.array([stamp_ns])
        if stamp_ns >= known.stamps_ns[robot]:
            last = np.array([known.stamps_ns[robot]])
            if np.any(track.pieces(moment) != track.pieces(last)):
                return None
            return known.robot(self.data, robot, stamp_ns).map_from_base
        if self.assembled is not None and robot in self.assembled.problem.chains:
            chain = self.assembled.problem.chains[robot]
            if not self._is_reached(robot, moment)[0]:
                return None
            nodes = self.state.robots[robot].map_from_base
            return interpolated(track, chain, nodes, moment)[0]
        return None

    # -- locating ---------------------------------------------------------------------------------

    def locate(self, camera: str) -> bool:
        """Try to locate a camera; whether that succeeded. The next solution uses it."""
        self.tries[camera] = self._placed_count(camera)
        if not self.tries[camera]:
            chains = self.assembled.problem.chains if self.assembled else {}
            self.undetermined[camera] = why_undetermined(
                self.data, camera, chains, self._robot_reasons
            )
            return False
        result = locate(self.data, self.state, camera)
        if isinstance(result, Undetermined):
            self.undetermined[camera] = result.reasons
            return False
        self.undetermined.pop(camera, None)
        self._take(camera, result)
        return True

    def _take(self, camera: str, located: Located) -> None:
        self.state = State(self.state.cameras | {camera: located.camera}, self.state.robots)
        for index, readings in located.readings.items():
            entry = self.data.entries[index]
            entry.observation = entry.observation.read_as(readings).judged(Verdict.ACCEPTED)
            entry.map_from_base = located.map_from_base.get(index, entry.map_from_base)

    def _drop_misplaced(self) -> bool:
        """Drop the pose of a camera most of whose observations contradict it, so that it is located
        anew; whether there was one."""
        for camera in list(self.state.cameras):
            if camera in self.data.known.poses:
                continue
            # What it saw of a robot that is not located yet contradicts nothing.
            entries = [e for e in self.data.of_camera(camera) if e.map_from_base is not None]
            accepted = sum(e.observation.verdict is Verdict.ACCEPTED for e in entries)
            if accepted * 2 >= len(entries) or outlier_rejection.may_have_moved(entries):
                continue
            self._drop(camera, "its pictures contradict each other")
            return True
        return False

    def _drop(self, camera: str, why: str) -> None:
        """Drop a camera's pose; its observations are judged anew."""
        cameras = {n: c for n, c in self.state.cameras.items() if n != camera}
        self.state = State(cameras, self.state.robots)
        entries = self.data.of_camera(camera)
        for entry in entries:
            entry.observation = entry.observation.judged(Verdict.PENDING)
        self.undetermined[camera] = (why,)
        self.tries[camera] = len(entries)
