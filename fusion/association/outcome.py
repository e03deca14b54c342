"""Combines all worlds of a session and holds each camera against the one rule of evidence."""

from itertools import pairwise

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.model.dataset import CameraMove, Lift
from trigpoint.fusion.model.observations import Observation
from trigpoint.fusion.model.problem import CameraState
from trigpoint.fusion.solver.filter import is_placed
from trigpoint.geometry import Pose

from .events import EVIDENCE, window
from .explanation import Alternative, CameraFinding, Explanation, Read, alternatives_of
from .mode import Mode, VisitModes
from .own_unknowns import camera_with
from .told_moves import of_camera
from .world import World

_SEVERAL = (
    "position and orientation: {} fit, and none of them holds all but "
    f"{EVIDENCE:.3%} of the probability; drive past it again, where it sees the robot from "
    "elsewhere"
)
_NOTHING = "its pictures contradict each other and the odometry"
_FEW = "no picture of it shows enough of a face to place it"
_LOST = (
    "position and orientation in the map: the robot was put down elsewhere, or its odometry "
    "jumped, on its way here from the other cameras; drive there without a break"
)
_UNSEEN = (
    "position and orientation in the map: it begins where robot {0} does, and no camera saw that "
    "robot; drive {0} past this camera, or past one that also saw another robot"
)
_LOOSE = (
    "position and orientation in the map: a robot was carried or a camera moved in this session, "
    "and nothing shows that the robot was not on its way here; drive from here past a camera that "
    "it met before"
)
_NUDGED = (
    "position and orientation: it was turned or shifted, as its pictures show, and has not seen a "
    "robot well enough since; drive past it"
)
_LATE = (
    "position and orientation in the map: not decided in time, since too much may have happened in "
    "this session; record it in several shorter ones"
)


class Outcome:
    """Combines all worlds into one explanation; how pictures are read is taken from the best one.

    `undecided`: cameras that are not to be located; `is_draft`: each camera is where the best world
    has it, whatever alternatives there are.
    """

    def __init__(
        self,
        worlds: list[World],
        observations: list[Observation],
        corner_scale: dict[str, float],
        undecided: frozenset[str] = frozenset(),
        *,
        is_draft: bool = False,
    ) -> None:
        self.is_draft = is_draft
        self.worlds, self.observations, self.corner_scale = worlds, observations, corner_scale
        self.best = min(worlds, key=lambda world: world.score)
        self.chosen = self.best.hypotheses[0]
        self.data = self.best.data
        self.loose = self._loose()
        self.undecided = undecided.union(*(world.undecided for world in worlds))

    def _loose(self) -> set[str]:
        """Cameras tied to the map only across a gap in which the robot may have been carried."""
        limit = self.best.score + window() - self.best.events.event_score
        found = [each for world in self.worlds for each in world.loose() if each[0] < limit]
        return {camera for _, cameras in found for camera in cameras}

    def explanation(self) -> Explanation:
        seen = dict.fromkeys(v.visit.camera for v in self.best.visits)
        findings = {camera: self._finding(camera) for camera in seen}
        for move in self.data.told:  # known from before, and not seen by any robot yet
            if move.camera in self.data.known.poses and move.camera not in seen:
                findings[move.camera] = CameraFinding((), _NUDGED)
        places = self._places(findings)
        return Explanation(
            observations=tuple(self.observations),
            reads=tuple(self._reads()),
            findings=findings,
            places=places,
            lifts=tuple(self._lifts()),
            moves=tuple(self._moves()),
            noise=self.best.noise.by_robot,
            corner_scale=self.corner_scale,
        )

    def _finding(self, camera: str) -> CameraFinding:
        if camera in self.undecided:
            return CameraFinding((), _LATE)
        if self._told_since(camera):
            return CameraFinding((), _NUDGED)
        alternatives = alternatives_of(
            place for world in self.worlds for place in world.places(camera, None)
        )
        if not alternatives:
            mine = [v for v in self.best.visits if v.visit.camera == camera]
            reason = _NOTHING if any(v.modes for v in mine) else _FEW
            return CameraFinding((), reason)
        if self.is_draft and is_placed(alternatives[0].covariance):
            return CameraFinding(alternatives[:1])
        if len(alternatives) > 1:
            return CameraFinding(alternatives, _several_fit(alternatives))
        if not is_placed(next(iter(alternatives)).covariance):
            return CameraFinding((), self._lost())
        if camera in self.loose:
            return CameraFinding(alternatives, _LOOSE)
        return CameraFinding(alternatives)

    def _lost(self) -> str:
        """Why nothing ties a camera to the map."""
        used = {self.best.visits[n].visit.robot for n in self.chosen.places}
        first = self.data.anchored_robot
        return _LOST if first is None or first in used else _UNSEEN.format(first)

    def _places(self, findings: dict[str, CameraFinding]) -> dict[tuple[str, int], CameraState]:
        """The camera's state at every place, earlier ones included, that has one alternative."""
        found = dict[tuple[str, int], Pose]()
        for n, place in self.chosen.places.items():
            camera = self.best.visits[n].visit.camera
            if camera in self.undecided:
                continue
            last = self._last_place(camera)
            if place == last and not self._told_since(camera):
                if findings[camera].is_located:
                    found[camera, place] = findings[camera].alternatives[0].map_from_camera
                continue
            alike = alternatives_of(p for world in self.worlds for p in world.places(camera, place))
            if len(alike) == 1 and is_placed(alike[0].covariance):
                found[camera, place] = alike[0].map_from_camera
        return {
            (camera, place): replace(self._camera(camera), map_from_camera=pose)
            for (camera, place), pose in found.items()
        }

    def _camera(self, name: str) -> CameraState:
        """A camera, at any pose, with lens and clock as all visits that tie it say together; by
        the most informative one where none does."""
        placed, seen = self.chosen.placed, self._seen(name)
        is_tied = any(number in self.chosen.ties for number in seen)
        if placed is not None and is_tied and name in placed.layout.own:
            return camera_with(self.data, name, placed.own(name))
        modes = [self.best.visits[number].modes[self._mode_of(number)] for number in seen]
        return max(modes, key=lambda mode: float(np.linalg.slogdet(mode.information)[1])).camera

    def _seen(self, camera: str) -> list[int]:
        """The numbers of a camera's visits that are right, in order of time."""
        return of_camera(self.chosen, self.best.visits, camera)

    def _last_place(self, camera: str) -> int:
        return max((self.chosen.place_of(n) or 0 for n in self._seen(camera)), default=0)

    def _told_since(self, camera: str) -> list[CameraMove]:
        """The moves that a camera told of after it was last seen to be somewhere."""
        mine = [self.best.visits[n].visit.until_ns for n in self._seen(camera)]
        return [
            move
            for move in self.data.told
            if move.camera == camera and max(mine, default=-1) <= move.until_ns
        ]

    def _is_placed(self, found: VisitModes) -> bool:
        """Whether a visit's camera was somewhere before all that was told of it."""
        camera = found.visit.camera
        return bool(self._seen(camera)) or camera in self.data.known.poses

    def _mode_of(self, number: int) -> int:
        """The mode by which a visit is read."""
        if number in self.chosen.ties:
            return self.chosen.ties[number].mode
        modes = self.best.visits[number].modes
        return int(np.argmin([mode.evidence for mode in modes]))

    # -- how pictures are read --------------------------------------------------------------------

    def _reads(self) -> list[Read]:
        reads: dict[int, Read] = {}
        for number, found in enumerate(self.best.visits):
            place = self.chosen.place_of(number)
            if place is None:
                last = self._last_place(found.visit.camera)
                told = self._told_since(found.visit.camera) if self._is_placed(found) else []
                if told and found.visit.stamp_ns >= told[-1].since_ns:
                    last += 1
                reads |= {index: self._wrong(index, last) for index in found.visit.indices}
            else:
                mode = found.modes[self._mode_of(number)]
                reads |= self._read_by(number, self.best.finder.completed(found.visit, mode), place)
        return [reads[index] for index in range(len(self.observations))]

    def _wrong(self, index: int, place: int) -> Read:
        views = self.observations[index].views
        wild = tuple(np.zeros(len(view.corners), bool) for view in views)
        return Read((None,) * len(views), wild, None, place)

    def _read_by(self, number: int, mode: Mode, place: int) -> dict[int, Read]:
        assert self.chosen.placed is not None
        visit = self.best.visits[number].visit
        node = self.best.graph.node_of[number]
        start = self.best.graph.paths[visit.robot].odometry[node]
        seen = self.best.graph.seen_since(number, [mode])[0]
        map_from_odom = self.chosen.placed.node(visit.robot, node) @ seen @ start.inverse()
        return {
            index: Read(
                mode.readings[index],
                mode.wild[index],
                map_from_odom @ mode.poses[index],
                place,
            )
            for index in visit.indices
        }

    # -- what happened ----------------------------------------------------------------------------

    def _lifts(self) -> list[tuple[Lift, ...]]:
        near = [
            h
            for h in self.best.hypotheses
            if h.score < self.chosen.score + window() and len(h.breaks) == len(self.chosen.breaks)
        ]
        found = []
        for robot, gap in sorted(self.chosen.breaks):
            others = {g for h in near for r, g in h.breaks if r == robot} - {
                g for r, g in self.chosen.breaks if r == robot
            }
            found.append(tuple(self._lift(robot, each) for each in [gap, *sorted(others)]))
        return found

    def _lift(self, robot: str, gap: int) -> Lift:
        """The lift in a gap between two nodes: from the last picture before it to the first after
        it, by the time at which each was taken."""
        stamps, node_of = self.best.graph.paths[robot].stamps_ns, self.best.graph.node_of
        mine = [n for n in self.chosen.places if self.best.visits[n].visit.robot == robot]
        after = [self._taken_ns(n)[0] for n in mine if node_of[n] > gap]
        before = min(after, default=int(stamps[gap + 1]))
        ends = [ns for n in mine if node_of[n] <= gap for ns in self._taken_ns(n)]
        # A visit that goes on past the lift does not tell when it was.
        last = max((ns for ns in ends if ns < before), default=int(stamps[gap]))
        return Lift(robot, min(last, before), before)

    def _taken_ns(self, number: int) -> tuple[int, int]:
        """When the first and the last picture of a visit were taken, by its camera's clock."""
        visit = self.best.visits[number].visit
        stamps_ns = np.array([visit.stamp_ns, visit.until_ns])
        first, last = self.data.true_times_ns(self._camera(visit.camera), stamps_ns)
        return int(first), int(last)

    def _moves(self) -> list[CameraMove]:
        found = []
        known = self.data.known.poses
        for camera in dict.fromkeys([*(v.visit.camera for v in self.best.visits), *known]):
            numbers = self._seen(camera)
            first = self.best.visits[numbers[0]].visit.stamp_ns if numbers else 0
            if numbers and self.chosen.place_of(numbers[0]):  # it hung elsewhere at first
                found.append(CameraMove(camera, first, first))
            for earlier, later in pairwise(numbers):
                if self.chosen.place_of(earlier) != self.chosen.place_of(later):
                    until, since = self.best.visits[earlier].visit, self.best.visits[later].visit
                    found.append(CameraMove(camera, until.until_ns, since.stamp_ns))
            if (numbers or camera in known) and (told := self._told_since(camera)):
                found.append(CameraMove(camera, told[0].until_ns, told[-1].since_ns))
        return found


def _several_fit(alternatives: tuple[Alternative, ...]) -> str:
    places = [
        "({:.2f}, {:.2f}, {:.2f}) m ({:.3g} %)".format(
            *place.map_from_camera.translation, 100 * place.probability
        )
        for place in alternatives
    ]
    if len(places) <= 4:
        return _SEVERAL.format(f"cameras at {', '.join(places[:-1])} and {places[-1]}")
    more = f"{len(places) - 3} more places"
    return _SEVERAL.format(f"cameras at {', '.join(places[:3])} and {more}")
