"""Which robot a camera saw, where several carry the same target.

They look alike, but they do not drive alike: over a visit to a camera only the robot that was there
moved as its pictures show. So every robot is a hypothesis, and a visit is a robot's where its
odometry alone fits, wherever the camera may be. Robots that drove alike are identified once their
poses in the map are known: by which of them was where a located camera shows it, or by how other
cameras saw each of them drive meanwhile.
"""

from collections import deque

import numpy as np
from msgspec.structs import replace

from trigpoint.fusion.association.budget import ALIKE_SHARE, Budget
from trigpoint.fusion.association.events import Events, window
from trigpoint.fusion.association.memory import Memory
from trigpoint.fusion.association.robots import Picture, RobotFit, fits, runs
from trigpoint.fusion.estimators.interface import Live
from trigpoint.fusion.model.dataset import DataSet, Entry
from trigpoint.fusion.model.gates import DECISIVE
from trigpoint.fusion.model.observations import Observation, Verdict, View, observation_of
from trigpoint.fusion.reading.alignment import placements
from trigpoint.geometry import Pose
from trigpoint.geometry.rotation import Array

from .past_poses import PastPoses
from .picture_runs import AWAY_NS, lasting, split, visits

_MOST_PICTURES = 256
# One picture fits any robot: its camera may be anywhere.
_LEAST_PICTURES = 2
# A run is looked at once, and again after each of two events in it.
_MOST_LOOKS = 3
# χ²: five sigmas from its estimated pose.
_AT_PLACE = 25.0
# A robot that was elsewhere fits only against its odometry, at several times the noise's χ².
_MOST_CHI2 = 2.0
# Pictures that wait for places in the map; as many as an hour of one busy camera has.
_MOST_LEFT = 16384
# Share of all pictures: fewer new ones of located cameras reduce no sigma by more than a fortieth,
# and are not worth explaining the whole session anew.
_LITTLE_MORE = 0.05
# Cost in units of the budget: every way to place a robot by one face.
_PLACEMENTS = 5e3
_NOT_TOLD = "their odometry does not tell which it was"
_DO = "give each robot its own target, or let one alone drive while the others stand"


class RobotIdentification:
    """Pictures of targets that several robots carry, until the robot is identified or the budget
    is spent, which grows with the robots' odometry. Not thread-safe.

    `untold`: how many pictures are not identified; `problem`: why, as text.
    """

    def __init__(self, data: DataSet) -> None:
        self._data, self._events = data, Events(data.site.fusion.priors)
        self._memory = Memory()
        self._budget = self._memory.budget
        self._open: dict[str, list[Picture]] = {}
        self._closed: list[tuple[str, list[Picture]]] = []
        self._left: deque[tuple[str, Picture]] = deque(maxlen=_MOST_LEFT)
        self._looked = (0, 0, 0)
        self.untold = 0
        # By camera, the last moment at which it shows a robot that was told, and the last at which
        # that was not decided in time.
        self._told_ns: dict[str, int] = {}
        self._late_ns: dict[str, int] = {}
        self.problem = ""

    def forget(self) -> None:
        """Begin anew, but for the counts, with a budget of its own."""
        self._memory = Memory()
        self._budget = self._memory.budget
        self._left.clear()
        self._told_ns.clear()
        self._late_ns.clear()

    def add(self, camera: str, stamp_ns: int, faces: tuple[dict[str, View], ...]) -> None:
        """Take one picture, each face as a view of every robot that may carry it; a late picture
        joins the visit that goes on."""
        self._open.setdefault(camera, []).append(Picture(stamp_ns, faces))

    def ready(self, *, is_end: bool = False) -> list[Observation]:
        """The identified observations of the visits that have ended by all robots' odometry or have
        reached the largest length, or of all visits at the end. Longer visits identify robots
        better and at less cost: a caller that has the time asks at the end alone."""
        tracks = [track for track in self._data.tracks.values() if len(track)]
        self._budget.allowed = Budget.of(tracks, share=ALIKE_SHARE).allowed
        until_ns = min((track.last_ns for track in tracks), default=0)
        for camera, visit in list(self._open.items()):
            is_over = max(p.stamp_ns for p in visit) + AWAY_NS < until_ns
            if is_end or is_over or len(visit) >= _MOST_PICTURES:
                self._closed.append((camera, self._open.pop(camera)))
        closed, self._closed = self._closed, []
        wanted: list[tuple[str, list[Picture]]] = []
        for camera, visit in closed:
            if not is_end and max(p.stamp_ns for p in visit) > until_ns:
                self._closed.append((camera, visit))
                continue
            visit = sorted(visit, key=lambda picture: picture.stamp_ns)
            wanted += [(camera, run) for run in runs(self._data, camera, visit)]
        # All are looked at once before any is looked at again.
        found: list[Observation] = []
        for look in range(_MOST_LOOKS):
            again: list[tuple[str, list[Picture]]] = []
            for camera, run in wanted:
                told, left = self._told(camera, run, is_last=look + 1 == _MOST_LOOKS)
                found += told
                if left:
                    again.append((camera, left))
            wanted = again
        return found

    @property
    def undecided(self) -> frozenset[str]:
        """The cameras that may have been moved at last: for their last pictures it was not decided
        in time which robot they show."""
        return frozenset(
            camera for camera, late in self._late_ns.items() if late > self._told_ns.get(camera, 0)
        )

    def by_place(self, estimator: Live, *, is_end: bool = False) -> list[Observation]:
        """The pictures left out so far that the poses of robots and cameras identify now; tried
        again once there are more of either, or more pictures, and at the end, where only a few more
        of located cameras are not used."""
        if not self._left or self._budget.is_spent:
            return []
        tied = sum(estimator.robot(robot) is not None for robot in self._data.site.robots)
        looked = (self.untold, estimator.located_count, tied)
        if not estimator.located_count or (looked == self._looked and not is_end):
            return []
        self._looked = looked
        places = PastPoses(self._data, estimator)
        before = self._left.copy(), self.untold
        found = self._shown_by_cameras(places) + self._told_by_other_cameras(places)
        few = _LITTLE_MORE * len(self._data.entries)
        if is_end and len(found) < few and all(places.camera(seen.camera) for seen in found):
            self._left, self.untold = before
            return []
        return found

    def _shown_by_cameras(self, places: PastPoses) -> list[Observation]:
        """Pictures of located cameras where only one robot stood."""
        found: list[Observation] = []
        left, self._left = self._left, deque(maxlen=_MOST_LEFT)
        for camera, picture in left:
            own: dict[str, list[View]] = {}
            rest = []
            for face in picture.faces:
                robot = self._stood_there(places, camera, picture.stamp_ns, face)
                if robot is None:
                    rest.append(face)
                else:
                    own.setdefault(robot, []).append(face[robot])
            found += [
                observation_of(camera, robot, picture.stamp_ns, tuple(views))
                for robot, views in own.items()
            ]
            if rest:
                self._left.append((camera, Picture(picture.stamp_ns, tuple(rest))))
            else:
                self.untold -= 1
        return found

    def _stood_there(
        self, places: PastPoses, camera: str, stamp_ns: int, face: dict[str, View]
    ) -> str | None:
        """The robot that was where a located camera shows the face, while every other one that may
        carry it was elsewhere; None where that is not known."""
        apart = {
            robot: self._apart(places, camera, robot, stamp_ns, view)
            for robot, view in face.items()
        }
        best, *others = sorted(apart, key=lambda robot: apart[robot])
        if not 0 <= apart[best] < _AT_PLACE:
            return None
        return best if all(apart[o] - apart[best] >= DECISIVE for o in others) else None

    def _apart(
        self, places: PastPoses, camera: str, robot: str, stamp_ns: int, view: View
    ) -> float:
        """χ² by which a robot was elsewhere than a camera shows it; -1 where that is not known, so
        that it may have been there."""
        there, stood = places.camera(camera), places.robot(robot, stamp_ns)
        if there is None or stood is None:
            return -1.0
        self._budget.spent += _PLACEMENTS
        observation = observation_of(camera, robot, stamp_ns, (view,))
        tangent = self._data.tracks[robot].tangent
        shown = placements(
            self._data.moving(observation, stamp_ns),
            self._data.targets[robot],
            there.lens,
            there.map_from_camera,
            tangent=tangent,
        )
        between = stood.map_from_base.translation - there.map_from_camera.translation
        covariance = stood.covariance + _of_camera(there.covariance, float(between @ between))
        inner = covariance[np.ix_(tangent, tangent)]
        differences = [pose.difference(stood.map_from_base)[tangent] for pose in shown]
        return min((float(d @ np.linalg.solve(inner, d)) for d in differences), default=np.inf)

    def _told_by_other_cameras(self, places: PastPoses) -> list[Observation]:
        """Visits to cameras that are not located, which one robot alone explains by how other
        cameras saw it drive at the time."""
        found: list[Observation] = []
        left, self._left = self._left, deque(maxlen=_MOST_LEFT)
        for camera, visit in visits(left):
            alone = None if places.camera(camera) else self._alone(places, camera, visit)
            if alone is None:
                self._left.extend((camera, picture) for picture in visit)
                continue
            told, rest = alone
            found += told
            self._left.extend((camera, picture) for picture in rest)
            self.untold -= len(visit) - len(rest)
        return found

    def _alone(
        self, places: PastPoses, camera: str, visit: list[Picture]
    ) -> tuple[list[Observation], list[Picture]] | None:
        """The observations of the robot to which a visit adds so little χ² that every other one is
        excluded, and the pictures left; None where there is no such robot."""
        best = self._best(camera, visit)
        if best is None:
            return None
        _, every = best
        added = {n: self._added(places, camera, n, fit, visit) for n, fit in every.items()}
        robot = min(added, key=lambda name: added[name])
        corners = sum(seen.corner_count for seen in every[robot].chosen().values())
        if added[robot] > _MOST_CHI2 * 2 * corners:
            return None
        if any(other - added[robot] < DECISIVE for n, other in added.items() if n != robot):
            return None
        return split(camera, robot, every[robot].right(visit), visit)

    def _added(
        self, places: PastPoses, camera: str, robot: str, fit: RobotFit, visit: list[Picture]
    ) -> float:
        """χ² that a visit adds to what located cameras saw of a robot at the time."""
        poses = fit.poses()
        middle = list(poses)[len(poses) // 2]
        stood = places.robot(robot, visit[middle].stamp_ns)
        shift = stood.map_from_base @ poses[middle].inverse() if stood else Pose.identity()
        entries = [
            Entry(seen.judged(Verdict.ACCEPTED), shift @ poses[order])
            for order, seen in fit.chosen().items()
        ]
        state = replace(fit.mode.camera, map_from_camera=shift @ fit.mode.map_from_camera)
        return places.added_chi2(camera, state, entries)

    def _told(
        self, camera: str, run: list[Picture], *, is_last: bool
    ) -> tuple[list[Observation], list[Picture]]:
        """The observations of a run by their robots, without a face that may be another's; and
        what is worth another look, unless this is the last one."""
        self._memory.alone.clear()
        told, unclear, rest = self._told_of(camera, run)
        last = max((seen.stamp_ns for seen in told), default=0)
        self._told_ns[camera] = max(self._told_ns.get(camera, 0), last)
        left = [] if is_last or not told else lasting(run, unclear + rest)
        again = {picture.stamp_ns for picture in left}
        unclear, rest = (
            [picture for picture in part if picture.stamp_ns not in again]
            for part in (unclear, rest)
        )
        # Beside a robot that was told, what no robot's motion explains is a wrong sighting or one
        # of a robot that passed by: not worth explaining the whole session anew.
        self._leave_out(camera, unclear, rest, is_worth=not told)
        return told, left

    def _told_of(
        self, camera: str, run: list[Picture]
    ) -> tuple[list[Observation], list[Picture], list[Picture]]:
        """The observations of each robot that a run shows, the pictures that may show one or
        another, and what is left of them all."""
        known: dict[str, tuple[RobotFit, list[Picture], bool]] = {}
        rest = run
        while rest:
            best = self._best(camera, rest)
            if best is None or best[0] in known:
                break
            robot, every = best
            right = every[robot].right(rest)
            shown = [rest[order].showing(faces) for order, faces in right.items() if faces]
            is_clear = self._is_clear(camera, robot, every, shown, of=rest)
            known[robot] = every[robot], shown, is_clear
            _, rest = split(camera, robot, right, rest)
        found, unclear = list[Observation](), list[Picture]()
        for robot, (_, shown, is_clear) in known.items():
            others = [fit for name, (fit, _, _) in known.items() if name != robot]
            alone = _alone_in(shown, others) if is_clear else {}
            own, doubtful = split(camera, robot, alone, shown)
            found += own
            unclear += doubtful
        return found, unclear, rest

    def _best(self, camera: str, visit: list[Picture]) -> tuple[str, dict[str, RobotFit]] | None:
        """The robot whose motion explains a visit best, and the fits of all that explain it; None
        where each of them may as well be wrong."""
        if len(visit) < _LEAST_PICTURES:
            return None
        every = {
            robot: fit for robot, fit in self._fits(camera, visit).items() if fit.gain > window()
        }
        return (max(every, key=lambda robot: every[robot].gain), every) if every else None

    def _is_clear(
        self,
        camera: str,
        robot: str,
        every: dict[str, RobotFit],
        shown: list[Picture],
        *,
        of: list[Picture],
    ) -> bool:
        """Whether this robot's fit leads all others: over the whole visit `of`, or over the
        pictures `shown` that its best fit assigns to it."""
        if _leads(robot, every):
            return True
        return shown != of and _leads(robot, self._fits(camera, shown))

    def _fits(self, camera: str, pictures: list[Picture]) -> dict[str, RobotFit]:
        """By robot, how it explains pictures; empty where the budget does not suffice for all of
        the robots: one that nothing was held against would lead."""
        found = fits(self._data, camera, pictures, self._events, self._memory)
        return {} if self._budget.is_spent else found

    def _leave_out(
        self, camera: str, unclear: list[Picture], rest: list[Picture], *, is_worth: bool
    ) -> None:
        """Leave out pictures; `is_worth`: to look at the rest again once places are known."""
        if not (unclear or rest):
            return
        self._left.extend((camera, picture) for picture in unclear + (rest if is_worth else []))
        self.untold += len(unclear) + len(rest)
        if is_worth and self._budget.is_spent:
            last = max(picture.stamp_ns for picture in unclear + rest)
            self._late_ns[camera] = max(self._late_ns.get(camera, 0), last)
        why = "which it was is not decided in time" if self._budget.is_spent else _NOT_TOLD
        self.problem = f"camera {camera} saw a target that several robots carry, and {why}; {_DO}"


def _alone_in(shown: list[Picture], others: list[RobotFit]) -> dict[int, tuple[int, ...]]:
    """By picture that shows a robot, the faces that none of the others that were there explains."""
    claimed = [other.claims(shown) for other in others]
    return {
        order: tuple(
            face
            for face in range(len(picture.faces))
            if not any(face in claims.get(order, ()) for claims in claimed)
        )
        for order, picture in enumerate(shown)
    }


def _leads(robot: str, every: dict[str, RobotFit]) -> bool:
    """Whether a robot's fit is better than any other's by more than `window()`."""
    gains = {name: fit.gain for name, fit in every.items()}
    return gains.pop(robot, 0.0) > max(gains.values(), default=0.0) + window()


def _of_camera(covariance: Array, distance_m2: float) -> Array:
    """Isotropic covariance (6, 6) that a camera's own uncertainty adds to a robot's pose by it."""
    shift, turn = np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])
    return np.diag(np.repeat([shift + distance_m2 * turn, turn], 3))
