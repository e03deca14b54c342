"""From messages to observations in order of time; mismatched, late and repeated ones are left out.

Pure: no bus, no clock. A sighting waits here until the odometry of its robot covers its moment,
which is only known as well as its camera's time offset.
"""

import heapq
from typing import NamedTuple

from msgspec.structs import replace

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import FaceSighting, Sightings
from trigpoint.fusion.estimators.interface import Live
from trigpoint.fusion.model.dataset import DataSet
from trigpoint.fusion.model.observations import Observation, View, observation_of, view_of
from trigpoint.geometry import CameraModel
from trigpoint.site.config import OFFSET_SIGMAS

from .left_out import LeftOut
from .robot_identity import RobotIdentification
from .standstills import Standstills

_MOST_WAITING = 4096
_REMEMBERED = 4096
_CLOCK_TOLERANCE_NS = to_ns(5.0)


class _Waiting(NamedTuple):
    """`latest_ns`: the latest true time at which the robot may have been seen; `order`: of their
    coming, each its own."""

    latest_ns: int
    order: int
    observation: Observation


class Intake:
    """Sightings on their way to the estimator of a data set. Not thread-safe. `left_out`: every
    message that is not used is counted here."""

    def __init__(self, data: DataSet) -> None:
        site, targets = data.site, data.targets
        self._site, self._targets, self._shared = site, targets, RobotIdentification(data)
        self._standstills = Standstills(data.tracks)
        self.left_out = LeftOut()
        self._waiting: dict[str, list[_Waiting]] = {robot: [] for robot in site.robots}
        self._seen: dict[str, dict[int, None]] = {camera: {} for camera in site.cameras}
        self._order = 0
        # Robots with equal targets look alike: by robot, the first one with its target.
        self._twins = {
            robot: next(twin for twin, other in targets.items() if other == target)
            for robot, target in targets.items()
        }
        # A picture shows each face of each robot once at most.
        self._most_faces = sum(len(target.faces) for target in targets.values())
        # By how much true time may be ahead of a camera's stamp.
        self._ahead_ns = {
            name: to_ns(camera.most_time_offset_s) for name, camera in site.cameras.items()
        }

    def learn(self, camera: str, offset_s: float, sigma_s: float) -> None:
        """Set what is known of a camera's time offset."""
        self._ahead_ns[camera] = to_ns(OFFSET_SIGMAS * sigma_s - offset_s)

    @property
    def depth(self) -> int:
        """How many observations wait for odometry."""
        return sum(len(queue) for queue in self._waiting.values())

    def add(self, camera: str, message: Sightings, lens: CameraModel) -> bool:
        """Take the sightings of one picture; whether they may add to the map."""
        if (message.width, message.height) != (lens.width, lens.height):
            self.left_out.add(
                "wrong_size",
                f"camera {camera} sends pictures of {message.width} × {message.height}, but its "
                f"intrinsics are for {lens.width} × {lens.height}; give it the right intrinsics",
                of=camera,
            )
            return False
        if not message.faces or self._is_repeated(camera, message.stamp_ns):
            return False
        if len(message.faces) > self._most_faces:
            self.left_out.add(
                "too_many_faces",
                f"camera {camera} sees {len(message.faces)} faces in one picture, but all targets "
                f"of the site have {self._most_faces}; it is left out, see who sends that",
                of=camera,
            )
            return False
        views, is_new = self._views(camera, message)
        for robot, seen in views.items():
            observation = observation_of(camera, robot, message.stamp_ns, tuple(seen))
            is_new |= self._queue(robot, observation)
        return is_new

    def _is_repeated(self, camera: str, stamp_ns: int) -> bool:
        seen = self._seen[camera]
        if stamp_ns in seen:
            self.left_out.add("repeated")
            return True
        seen[stamp_ns] = None
        if len(seen) > _REMEMBERED:
            del seen[next(iter(seen))]
        return False

    def _views(self, camera: str, message: Sightings) -> tuple[dict[str, list[View]], bool]:
        """The views by robot, and whether there are others, of robots yet to be identified, that
        may add to the map."""
        views: dict[str, list[View]] = {}
        shared: list[dict[str, View]] = []
        eye = self._site.cameras[camera]
        for face in message.faces:
            robots = self._robots_of(face)
            by_twin = {
                twin: view_of(self._targets[twin], face, eye)
                for twin in {self._twins[robot] for robot in robots}
            }
            by_robot = {robot: by_twin[self._twins[robot]] for robot in robots}
            possible = {robot: view for robot, view in by_robot.items() if view is not None}
            if not robots:
                self.left_out.add(
                    "unknown_target",
                    f"camera {camera} sees a target «{face.target}» that no robots carry; give "
                    "each robot its own target",
                    of=camera,
                )
            elif not possible:
                self.left_out.add(
                    "unknown_face",
                    f"camera {camera} sees a face {face.face} that the target "
                    f"«{self._targets[robots[0]].name}» does not have; use one target file",
                    of=camera,
                )
            elif len(robots) > 1:
                shared.append(possible)
            else:
                views.setdefault(robots[0], []).append(possible[robots[0]])
        if not shared:
            return views, False
        self._shared.add(camera, message.stamp_ns, tuple(shared))
        return views, not self._is_shown_again(camera, message.stamp_ns, shared)

    def _is_shown_again(self, camera: str, stamp_ns: int, faces: list[dict[str, View]]) -> bool:
        """Whether faces that several robots may carry only repeat what was seen before."""
        robots = tuple(sorted({robot for face in faces for robot in face}))
        views = tuple(view for face in faces for view in list(face.values())[:1])
        return self._standstills.shown_again(camera, robots, stamp_ns, views)

    def forget(self) -> None:
        """Note that the odometry's past was dropped."""
        self._shared.forget()

    def tell_apart(self, *, is_end: bool = False) -> None:
        """Queue the sightings of identical targets whose robot is identified by now; `is_end`: of
        all that came."""
        for observation in self._shared.ready(is_end=is_end):
            self._queue(observation.robot, observation, has_odometry=True)
        self._count_untold()

    def tell_by_place(self, estimator: Live, *, is_end: bool = False) -> bool:
        """Queue the sightings of identical targets whose robot is identified by the estimator's
        poses; whether there were any. `is_end`: also where nothing has come in since the last
        call."""
        found = self._shared.by_place(estimator, is_end=is_end)
        for observation in found:
            self._queue(observation.robot, observation, has_odometry=True)
        self._count_untold()
        return bool(found)

    @property
    def undecided(self) -> frozenset[str]:
        """See `RobotIdentification.undecided`."""
        return self._shared.undecided

    def _count_untold(self) -> None:
        shared = self._shared
        more = shared.untold - self.left_out.counts["untold_robot"]
        self.left_out.add("untold_robot", shared.problem if more > 0 else "", count=more)
        if not shared.untold and self.left_out.last_problem == shared.problem:
            self.left_out.last_problem = ""

    def robots_in(self, message: Sightings) -> set[str]:
        """The robots that a picture may show."""
        return {robot for face in message.faces for robot in self._robots_of(face)}

    def _robots_of(self, face: FaceSighting) -> list[str]:
        if not face.target:
            return list(self._targets)
        return [robot for robot, target in self._targets.items() if target.name == face.target]

    def _queue(self, robot: str, observation: Observation, *, has_odometry: bool = False) -> bool:
        """Have an observation wait for its odometry; whether it may add to the map. `has_odometry`:
        it is there already."""
        if self._standstills.repeats(observation):
            observation = replace(observation, is_repeat=True)
            self.left_out.add("standing_still")
        queue = self._waiting[robot]
        if len(queue) >= _MOST_WAITING and not has_odometry:
            heapq.heappop(queue)
            text = f"no odometry of {robot}; check its bridge"
            self.left_out.add("without_odometry", text, of=robot)
        self._order += 1
        latest_ns = observation.stamp_ns + self._ahead_ns[observation.camera]
        heapq.heappush(queue, _Waiting(latest_ns, self._order, observation))
        return not observation.is_repeat

    def ready(
        self, robot: str, first_ns: int, last_ns: int, most: int | None = None
    ) -> list[Observation]:
        """The observations of a robot whose moments odometry covers now, in order of time; at most
        `most` of them.

        Those from before its odometry began are left out.
        """
        queue, found = self._waiting[robot], []
        while queue and queue[0].latest_ns <= last_ns and (most is None or len(found) < most):
            waiting = heapq.heappop(queue)
            if waiting.latest_ns < first_ns:
                self.left_out.add("before_odometry")
            else:
                found.append(waiting.observation)
        self._drop_far_ahead(robot, last_ns)
        return found

    def has_ready(self, robot: str, last_ns: int) -> bool:
        """Whether observations of a robot wait that odometry covers."""
        queue = self._waiting[robot]
        return bool(queue) and queue[0].latest_ns <= last_ns

    def waits_for(self, robot: str) -> bool:
        """Whether anything waits for a robot's odometry."""
        return bool(self._waiting.get(robot))

    def rest(self, robot: str, last_ns: int) -> list[Observation]:
        """At the end of the odometry: the observations whose stamps are within it, although their
        true time may not be."""
        queue = self._waiting[robot]
        kept, found = [], []
        for waiting in sorted(queue):
            is_within = waiting.observation.stamp_ns <= last_ns
            (found if is_within else kept).append(waiting)
        self._waiting[robot] = kept
        return [waiting.observation for waiting in found]

    def _drop_far_ahead(self, robot: str, last_ns: int) -> None:
        """Drop the sightings of a camera whose clock is far ahead, which would wait for ever."""
        queue = self._waiting[robot]
        ahead = [w for w in queue if w.observation.stamp_ns > last_ns + _CLOCK_TOLERANCE_NS]
        if len(ahead) > 64:
            camera = ahead[0].observation.camera
            self.left_out.add(
                "far_ahead",
                f"camera {camera} is {(ahead[0].latest_ns - last_ns) / 1e9:.0f} s ahead of the "
                f"odometry of {robot}; synchronise its clock, or check that odometry comes",
                of=camera,
                count=len(ahead),
            )
            gone = {waiting.order for waiting in ahead}
            kept = [waiting for waiting in queue if waiting.order not in gone]
            heapq.heapify(kept)
            self._waiting[robot] = kept
